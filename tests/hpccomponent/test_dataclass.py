"""`hpccomponent.dataclass` makes what the standard library's makes."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from dataclasses import field
from inspect import signature
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.dataclass import dataclass

MAKERS = (dataclasses.dataclass, dataclass)
VALUES = st.one_of(
    st.none(), st.integers(), st.text(max_size=3), st.lists(st.integers(), max_size=2)
)


def make(maker: Any, **options: Any) -> SimpleNamespace:
    """Return a family of classes that one of the two makes."""

    @maker(slots=True, **options)
    class Base:
        kind: ClassVar[str] = "base"
        a: Any
        b: Any = field(default=2, repr=False)

    @maker(slots=True, **options)
    class Derived(Base):
        c: Any = field(default_factory=list, compare=False)
        d: Any = field(default="d", kw_only=True)
        e: Any = field(default=5, init=False)

        def __post_init__(self) -> None:
            object.__setattr__(self, "e", (self.a, self.e))

    @maker(slots=True, kw_only=True, **options)
    class Named:
        a: Any
        b: Any = 2

    return SimpleNamespace(Base=Base, Derived=Derived, Named=Named)


def outcome(function: Any, *values: Any, **named: Any) -> Any:
    """Return what a call gives, or the type of what it raises."""
    try:
        return function(*values, **named)
    except Exception as error:
        return type(error)


def shown(value: Any) -> Any:
    """Return a value as text; a class of errors by its name."""
    return value.__name__ if isinstance(value, type) else repr(value)


FAMILIES = [
    [make(maker, **options) for maker in MAKERS]
    for options in ({}, {"frozen": True}, {"frozen": True, "eq": False}, {"order": True})
]


@given(
    family=st.sampled_from(FAMILIES),
    name=st.sampled_from(["Base", "Derived", "Named"]),
    values=st.lists(VALUES, max_size=4),
    named=st.dictionaries(st.sampled_from("abcdef"), VALUES, max_size=3),
    other=st.lists(VALUES, min_size=1, max_size=3),
)
def test_instances_behave_as_those_of_the_standard_library(
    family: list[SimpleNamespace],
    name: str,
    values: list[Any],
    named: dict[str, Any],
    other: list[Any],
) -> None:
    def look(kind: Any) -> list[str]:
        first = outcome(kind, *values, **named)
        if isinstance(first, type):
            return [shown(first)]
        twin, second = kind(*values, **named), outcome(kind, *other)
        seen = [
            first, first == twin, first == second, first == object(), copy.deepcopy(first),
            outcome(hash, first) if kind.__eq__ is not object.__eq__ else "by identity",
            outcome(lambda: first < second), outcome(lambda: first >= twin),
            outcome(setattr, first, "a", 1),
            outcome(delattr, twin, "a"), outcome(lambda: dataclasses.asdict(first)),
            outcome(dataclasses.replace, first, a=7), [f.name for f in dataclasses.fields(kind)],
            kind.__match_args__,
        ]  # fmt: skip
        return [shown(value) for value in seen]

    standard, ours = (look(getattr(kinds, name)) for kinds in family)
    assert ours == standard


@dataclass(frozen=True, slots=True)
class Travelling:
    """A class that is found by its name."""

    a: int
    b: tuple[int, ...] = ()


def test_frozen_values_travel() -> None:
    assert pickle.loads(pickle.dumps(Travelling(1, (2, 3)))) == Travelling(1, (2, 3))  # noqa: S301


@pytest.mark.parametrize("maker", MAKERS)
def test_methods_of_the_class_stay(maker: Any) -> None:
    @maker(frozen=True, slots=True)
    class Own:
        a: int

        def __repr__(self) -> str:
            return "mine"

        def __eq__(self, other: object) -> bool:
            return True

    made: Any = Own
    assert repr(made(1)) == "mine"
    assert made(1) == 3
    assert hash(made(1)) == hash((1,))


def test_what_is_missing_is_named() -> None:
    with pytest.raises(TypeError, match="'a'"):
        Travelling()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="'z'"):
        Travelling(1, z=3)  # type: ignore[call-arg]


def test_a_class_tells_what_it_is_called_with() -> None:
    kinds = make(dataclass, frozen=True)
    assert str(signature(kinds.Derived)).replace("'Any'", "Any") == (
        "(a: Any, b: Any = 2, c: Any = Ellipsis, *, d: Any = 'd')"
    )

    class Other(kinds.Base):  # type: ignore[name-defined, misc]
        def __init__(self, z: int) -> None: ...

    assert str(signature(Other)) == "(z: 'int') -> 'None'"
