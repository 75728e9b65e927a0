"""Rows cut into batches."""

from __future__ import annotations

from itertools import pairwise


def cut_equal(rows: int, batches: int) -> list[slice]:
    """Cut `rows` rows into at most `batches` runs, equal to within one row, none empty.

    Examples
    --------
    >>> cut_equal(5, 2)
    [slice(0, 3, None), slice(3, 5, None)]
    >>> cut_equal(1, 4)
    [slice(0, 1, None)]
    """
    batches = max(1, min(batches, rows))
    short, longer = divmod(rows, batches)
    starts = [i * short + min(i, longer) for i in range(batches + 1)]
    return [slice(a, b) for a, b in pairwise(starts) if a < b]
