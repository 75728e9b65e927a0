"""What a record's arrays are, on its fields; the pattern of the record follows from these.

::

    @record("example.links")
    @dataclass(frozen=True, slots=True, eq=False)
    class Links:
        ends: Annotated[NDArray[np.int64], Column("l", 2, low=0)]
        contacts: Annotated[NDArray[np.int64], Column("l", low=1)]

    pattern_of(Links, ends=Bounds(high=len(nodes) - 1))

A field says what holds in every job: dtype, shape, range, unit. What hangs on the arguments of a
task is given where the task is declared. The reference page of results is made of the same fields.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.declared import Declared, Number, Record, Where, Whole
from hpccomponent.protocol.declared_arrays import Array

if TYPE_CHECKING:  # as in `declared_arrays`
    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True, init=False, eq=False)
class Column:
    """An array in a record, whose dtype is in the annotation; parameters as those of `Array`.

    `unit` is that of its entries, for the reader.
    """

    shape: tuple[int | str, ...]
    low: ArrayLike | None
    high: ArrayLike | None
    finite: bool
    rises: bool
    unit: str

    def __init__(
        self,
        *shape: int | str,
        low: ArrayLike | None = None,
        high: ArrayLike | None = None,
        finite: bool = True,
        rises: bool = False,
        unit: str = "",
    ) -> None:
        values = shape, low, high, finite, rises, unit
        for name, value in zip(self.__slots__, values, strict=True):
            object.__setattr__(self, name, value)


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """What the arguments of a task say of an array.

    `low`, `high` and `total`, as of `Array`, stand instead of the column's own. `agrees` tells of
    an array that fits whether it is right; `rule` is what that means, for the message.
    """

    low: ArrayLike | None = None
    high: ArrayLike | None = None
    total: tuple[int, int] | None = None
    agrees: Callable[[Any], bool] | None = None
    rule: str = ""

    def of(self, form: Any, sizes: Mapping[str, int] | None = None) -> Declared:
        """Return the pattern of an array by its `Column`; `sizes` are extents that are known."""
        dtype, column = read_column(form)
        pattern = Array(
            dtype,
            *(_extent(extent, sizes or {}) for extent in column.shape),
            low=column.low if self.low is None else self.low,
            high=column.high if self.high is None else self.high,
            finite=column.finite,
            rises=column.rises,
            total=self.total,
        )
        return pattern if self.agrees is None else Where(pattern, self.agrees, self.rule)


ANY = Bounds()
_NUMBERS: dict[Any, Declared] = {int: Whole(), float: Number()}


def _extent(extent: int | str, sizes: Mapping[str, int]) -> int | str:
    name, _, more = str(extent).partition("+")
    return sizes[name] + int(more or 0) if name in sizes else extent


@cache
def read_column(form: Any) -> tuple[str, Column]:
    """Return the dtype of an array, as of `Array`, and its `Column`; TypeError if it has none."""
    import numpy as np

    if get_origin(form) is not Annotated or not isinstance(form.__metadata__[0], Column):
        raise TypeError(f"{form} has no Column")
    dtype = np.dtype(get_args(get_args(form.__origin__)[1])[0])
    return dtype.newbyteorder("<").str, form.__metadata__[0]


@cache
def field_types(kind: type) -> dict[str, Any]:
    """Return the types of a record's fields, with their columns."""
    return get_type_hints(kind, include_extras=True)


def pattern_of(
    kind: type, sizes: Mapping[str, int] | None = None, /, **given: Bounds | Declared
) -> Record:
    """Return the pattern of a record whose fields are numbers, and arrays with a `Column`.

    `sizes` are extents that are known; `given` is what the task knows of a field: bounds of an
    array, or a pattern instead of the field's. Raise TypeError where the record has no such field,
    or a field that is something else.
    """
    forms = field_types(kind)
    if unknown := given.keys() - forms.keys():
        raise TypeError(f"{kind.__qualname__} has no {', '.join(sorted(unknown))}")
    items: dict[str, Declared] = {}
    for name, form in forms.items():
        known = given.get(name, _NUMBERS.get(form) or ANY)
        items[name] = known.of(form, sizes) if isinstance(known, Bounds) else known
    return Record(kind, **items)
