"""What a task declares of an array: dtype, shape, and what its entries may be."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ProtocolError

if TYPE_CHECKING:  # who only declares, or starts a worker, does not wait for numpy
    import numpy as np
    from numpy.typing import ArrayLike

    AnyArray = np.ndarray[Any, Any]


_AT_ONCE = 1 << 16  # entries: what is made of them stays in the cache

Extents = dict[str, int]
"""By their names."""


@dataclass(frozen=True, slots=True, init=False, eq=False)
class Array:
    """An ndarray.

    Parameters
    ----------
    dtype : str
        As ``dtype.str`` has it, little-endian: ``<f8``, ``<i8``, ``|b1``.
    *shape : int or str
        Each extent: a number, or a name, to which a number may be added: ``n``, ``n+1``.
    low, high : number or ndarray, optional
        The least and the greatest entry; of an array, those of each column, or of each entry.
    finite : bool
        Whether NaN and infinite entries are refused; where there are bounds, NaN is in any case.
    rises : bool
        Whether each entry is greater than the one before it.
    total : tuple of two int, optional
        The least and the greatest sum of the entries, which are integers and not negative.
    """

    dtype: str
    shape: tuple[int | str, ...]
    low: ArrayLike | None
    high: ArrayLike | None
    finite: bool
    rises: bool
    total: tuple[int, int] | None

    def __init__(
        self,
        dtype: str,
        *shape: int | str,
        low: ArrayLike | None = None,
        high: ArrayLike | None = None,
        finite: bool = True,
        rises: bool = False,
        total: tuple[int, int] | None = None,
    ) -> None:
        for name, value in zip(
            self.__slots__, (dtype, shape, low, high, finite, rises, total), strict=True
        ):
            object.__setattr__(self, name, value)

    def check(self, value: object, place: str, extents: Extents) -> None:
        """See `Declared`."""
        import numpy as np

        if not isinstance(value, np.ndarray):
            raise ProtocolError(f"{place} is of type {type(value).__name__}, not ndarray")
        if value.dtype.newbyteorder("<").str != self.dtype:
            raise ProtocolError(f"{place} has the dtype {value.dtype.str}, not {self.dtype}")
        fits = len(value.shape) == len(self.shape) and all(
            _fits(extent, wanted, extents)
            for extent, wanted in zip(value.shape, self.shape, strict=True)
        )
        if not fits:
            raise ProtocolError(f"{place} has the shape {value.shape}, not {self._say(extents)}")
        if value.size:
            self._check_entries(value, place)
        if self.total is not None:
            self._check_total(value, place, *self.total)

    def _check_entries(self, value: AnyArray, place: str) -> None:
        may_be_nan = value.dtype.kind in "fc"
        if self.finite and may_be_nan and not _is_finite(value):
            raise ProtocolError(f"{place} has entries that are NaN or infinite")
        # Written so that NaN does not pass.
        if self.low is not None and not _holds(value, self.low, 1):
            raise ProtocolError(f"{place} has entries below {_name(self.low)}")
        if self.high is not None and not _holds(value, self.high, -1):
            raise ProtocolError(f"{place} has entries above {_name(self.high)}")
        if self.rises and not (value[1:] > value[:-1]).all():
            raise ProtocolError(f"{place} has entries that are not above the one before")

    def _check_total(self, value: AnyArray, place: str, least: int, most: int) -> None:
        # No entry may be so large that the sum comes round.
        largest, total = int(value.max(initial=0)), int(value.sum(dtype="i8"))
        if largest > most or not least <= total <= most:
            wanted = str(most) if least == most else f"from {least} to {most}"
            raise ProtocolError(f"{place} adds up to something else than {wanted}")

    def _say(self, extents: Extents) -> str:
        names = dict.fromkeys(
            extent.partition("+")[0] for extent in self.shape if isinstance(extent, str)
        )
        known = [f"{name} = {extents[name]}" for name in names if name in extents]
        shape = ", ".join(map(str, self.shape)) + ("," if len(self.shape) == 1 else "")
        return f"({shape})" + (f" with {', '.join(known)}" if known else "")


def _fits(extent: int, wanted: int | str, extents: Extents) -> bool:
    if isinstance(wanted, int):
        return extent == wanted
    name, _, more = wanted.partition("+")
    base = extent - int(more or 0)
    return base >= 0 and extents.setdefault(name, base) == base


def _is_finite(value: AnyArray) -> bool:
    import numpy as np

    flat = value.reshape(-1)
    return all(
        bool(np.isfinite(flat[start : start + _AT_ONCE]).all())
        for start in range(0, len(flat), _AT_ONCE)
    )


def _holds(value: AnyArray, bound: Any, sign: int) -> bool:
    """Tell whether all entries are `bound` or more; with the sign -1, or less."""
    import numpy as np

    if np.ndim(bound) == 0:
        return bool(value.min() >= bound if sign > 0 else value.max() <= bound)
    if np.ndim(bound) == value.ndim:
        return bool((value >= bound if sign > 0 else value <= bound).all())
    columns = value.reshape(-1, value.shape[-1]).T  # of rows of three a reduction is slow
    return all(
        bool(column.min() >= one if sign > 0 else column.max() <= one)
        for column, one in zip(columns, bound, strict=True)
    )


def _name(bound: object) -> str:
    return str(bound) if isinstance(bound, int | float) else "what is possible there"
