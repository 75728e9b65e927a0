"""Sets of places on a lattice as kernels: see `types.lattice`, whose functions these are."""

from __future__ import annotations

from hpccomponent.surface.types import lattice
from hpccomponent.surface.types.lattice import spread_keys, unite_keys
from hpccomponent.surface.types.points import IntArray

__all__ = ["find_keys", "spread_keys", "unite_keys"]


def find_keys(keys: IntArray, wanted: IntArray, threads: int = 1) -> IntArray:
    """Return where each of some keys stands among sorted keys; see `lattice.find_keys`.

    Parameters
    ----------
    keys : ndarray of int64, shape (k,)
        Sorted, unique.
    wanted : ndarray of int64, shape (...)
    threads : int
        Has no effect here.

    Returns
    -------
    ndarray of int64, shape (...)
        The row in `keys`, and k where a key is missing.
    """
    del threads  # numpy runs on one
    return lattice.find_keys(keys, wanted)
