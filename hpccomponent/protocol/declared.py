"""What a task declares of its result, and the check of a value against it.

A declaration is a pattern: what kinds of values stand where, with the dtypes, shapes and ranges of
arrays. An extent that has a name is the same wherever the name stands::

    Fixed(Array("<f8", "v", 3), Array("<i4", "f", 3, low=0), Whole(0, 100))

A worker checks its own result, where a misfit is the task's mistake; a master checks what workers
send, where it is theirs.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.declared_arrays import Extents


class Declared(Protocol):
    """A pattern of values."""

    def check(self, value: object, place: str, extents: Extents) -> None:
        """Raise ProtocolError where a value that is decoded, or could be encoded, does not fit.

        `extents` are those that have been met, by their names; more are added.
        """
        ...


def check_result(declared: Declared, value: object) -> None:
    """Raise ProtocolError, which says where, for a result that is not what its task declares.

    Examples
    --------
    >>> import numpy as np
    >>> from hpccomponent.protocol.declared_arrays import Array
    >>> pattern = Fixed(Array("<f8", "n", 3), Array("|b1", "n"))
    >>> check_result(pattern, (np.zeros((2, 3)), np.ones(2, bool)))
    >>> check_result(pattern, (np.zeros((2, 3)), np.ones(1, bool)))
    Traceback (most recent call last):
    hpccomponent.errors.ProtocolError: the result[1] has the shape (1,), not (n,) with n = 2
    """
    declared.check(value, "the result", {})


def _refuse(place: str, value: object, wanted: str) -> ProtocolError:
    return ProtocolError(f"{place} is of type {type(value).__name__}, not {wanted}")


@dataclass(frozen=True, slots=True)
class Anything:
    """object value that may travel: what a task returns that declares nothing."""

    def check(self, value: object, place: str, extents: Extents) -> None:
        """Let everything pass."""


ANYTHING = Anything()


@dataclass(frozen=True, slots=True)
class Nothing:
    """None."""

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        del extents
        if value is not None:
            raise _refuse(place, value, "None")


@dataclass(frozen=True, slots=True)
class Flag:
    """A bool."""

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        del extents
        if type(value) is not bool:
            raise _refuse(place, value, "bool")


@dataclass(frozen=True, slots=True)
class Whole:
    """An int from `low` to `high`, by default what an index can be."""

    low: int = 0
    high: int = 2**62

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        del extents
        if type(value) is not int:
            raise _refuse(place, value, "int")
        if not self.low <= value <= self.high:
            raise ProtocolError(f"{place} is not from {self.low} to {self.high}")


@dataclass(frozen=True, slots=True)
class Number:
    """A float from `low` to `high`, by default any that is finite, and not NaN."""

    low: float = -sys.float_info.max
    high: float = sys.float_info.max

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        del extents
        if type(value) is not float:
            raise _refuse(place, value, "float")
        if not self.low <= value <= self.high:
            raise ProtocolError(f"{place} is {value}, not from {self.low:g} to {self.high:g}")


@dataclass(frozen=True, slots=True)
class Text:
    """A str of at most `most` characters."""

    most: int = 1000

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        del extents
        if type(value) is not str:
            raise _refuse(place, value, "str")
        if len(value) > self.most:
            raise ProtocolError(f"{place} has {len(value)} characters, more than {self.most}")


@dataclass(frozen=True, slots=True)
class Exactly:
    """A value that the master knows: a str, a number, or a tuple of such."""

    value: object

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        del extents
        if type(value) is not type(self.value):
            raise _refuse(place, value, type(self.value).__name__)
        if value != self.value:
            raise ProtocolError(f"{place} is not {self.value!r}")


@dataclass(frozen=True, slots=True, init=False)
class Fixed:
    """A tuple of so many items."""

    items: tuple[Declared, ...]

    def __init__(self, *items: Declared) -> None:
        object.__setattr__(self, "items", items)

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        if type(value) is not tuple or len(value) != len(self.items):
            raise _refuse(place, value, f"a tuple of {len(self.items)}")
        for index, (item, entry) in enumerate(zip(self.items, value, strict=True)):
            item.check(entry, f"{place}[{index}]", extents)


@dataclass(frozen=True, slots=True, init=False)
class Record:
    """A record (see `hpccomponent.protocol.records`)."""

    kind: type
    items: tuple[tuple[str, Declared], ...]

    def __init__(self, kind: type, /, **items: Declared) -> None:
        object.__setattr__(self, "kind", kind)
        object.__setattr__(self, "items", tuple(items.items()))

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        if type(value) is not self.kind:
            raise _refuse(place, value, self.kind.__name__)
        for name, item in self.items:
            item.check(getattr(value, name), f"{place}.{name}", extents)


@dataclass(frozen=True, slots=True)
class Each:
    """A list of items of one kind, `count` if given; the names of extents are each item's own."""

    item: Declared
    count: int | None = None

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        del extents
        if type(value) is not list:
            raise _refuse(place, value, "a list")
        if self.count is not None and len(value) != self.count:
            raise ProtocolError(f"{place} has {len(value)} items, not {self.count}")
        if isinstance(self.item, Anything):
            return
        for index, entry in enumerate(value):
            self.item.check(entry, f"{place}[{index}]", {})


@dataclass(frozen=True, slots=True)
class EachOf:
    """A list of items that are declared one by one."""

    items: Sequence[Declared]

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        del extents
        if type(value) is not list or len(value) != len(self.items):
            raise _refuse(place, value, f"a list of {len(self.items)}")
        for index, (item, entry) in enumerate(zip(self.items, value, strict=True)):
            item.check(entry, f"{place}[{index}]", {})


@dataclass(frozen=True, slots=True, init=False)
class Either:
    """One of several patterns: the first that fits counts."""

    choices: tuple[Declared, ...]

    def __init__(self, *choices: Declared) -> None:
        object.__setattr__(self, "choices", choices)

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        complaints = []
        for choice in self.choices:
            met = dict(extents)
            try:
                choice.check(value, place, met)
            except ProtocolError as error:
                complaints.append(error.problem)
            else:
                extents.update(met)
                return
        raise ProtocolError(" and ".join(dict.fromkeys(complaints)))


@dataclass(frozen=True, slots=True)
class Where:
    """A pattern whose parts must also agree with one another.

    `agrees` tells of a value that fits whether they do; `rule`, for the message, in what.
    """

    pattern: Declared
    agrees: Callable[[Any], bool]
    rule: str

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        self.pattern.check(value, place, extents)
        if not self.agrees(value):
            raise ProtocolError(f"{place} is not consistent: {self.rule}")
