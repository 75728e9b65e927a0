"""Records: frozen dataclasses that travel as themselves, by a registered name and their fields.

The registry says what a name means, so that nothing is unpickled: a message can only ask for a
class that this process has registered, and give it the fields that it has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ProtocolError

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class RecordType:
    """A registered class."""

    kind: type
    name: str
    fields: tuple[str, ...]


_BY_NAME: dict[str, RecordType] = {}
_BY_KIND: dict[type, RecordType] = {}


def record(name: str) -> Callable[[type[T]], type[T]]:
    """Let a frozen dataclass travel by a unique name, as ``surface.part``.

    The decorator stands above that of the dataclass. Raise TypeError where the class is no frozen
    dataclass, or does more when made than keep its fields, ValueError where another class has the
    name.

    Examples
    --------
    >>> @record("doctest.circle")
    ... @dataclass(frozen=True)
    ... class Circle:
    ...     radius: float
    >>> make_record("doctest.circle", {"radius": 2.0})
    Circle(radius=2.0)
    """

    def register(kind: type[T]) -> type[T]:
        if not is_dataclass(kind) or kind.__setattr__ is object.__setattr__:
            raise TypeError(f"{kind.__qualname__} is no frozen dataclass")
        if hasattr(kind, "__post_init__"):
            raise TypeError(f"{kind.__qualname__} does more than keep its fields")
        known = _BY_NAME.get(name)
        if known is not None and known.kind.__qualname__ != kind.__qualname__:
            raise ValueError(f"the record {name!r} is {known.kind.__qualname__} already")
        entry = RecordType(kind, name, tuple(field.name for field in fields(kind)))
        _BY_NAME[name] = _BY_KIND[kind] = entry
        return kind

    return register


def find_record(kind: type) -> RecordType | None:
    """Return how values of a class travel."""
    return _BY_KIND.get(kind)


def make_record(name: str, values: Mapping[str, object]) -> Any:
    """Return the record of a name and its fields; ProtocolError where no class here has both."""
    entry = _BY_NAME.get(name)
    if entry is None:
        raise ProtocolError(f"a record of the unknown name {name[:40]!r}")
    if tuple(values) != entry.fields:
        raise ProtocolError(f"a record {name!r} has not the fields {', '.join(entry.fields)}")
    return entry.kind(**values)
