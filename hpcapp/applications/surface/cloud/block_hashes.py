"""What tells the points in some blocks of a cloud from others: a hash of each block."""

from __future__ import annotations

import hashlib
from itertools import pairwise

import numpy as np

from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.arrangement import RECORDS_AT_ONCE
from hpcapp.applications.surface.cloud.cutting import cut_even
from hpcapp.geometry.lattice import find_keys
from hpcapp.geometry.points import IntArray


class BlockHashes:
    """The hashes of a cloud's blocks; the points are read once, when they are first asked for."""

    def __init__(self, cloud: ArrangedCloud) -> None:
        self._cloud = cloud
        self._hashes: IntArray | None = None

    def of(self, keys: IntArray) -> tuple[IntArray, IntArray]:
        """Return which of some blocks hold points, keys (b,), and hashes of these, (b, 2)."""
        if self._hashes is None:
            self._hashes = _hash_all(self._cloud)
        rows = find_keys(self._cloud.keys, keys)
        rows = rows[rows < len(self._cloud.keys)]
        return self._cloud.keys[rows], self._hashes[rows]


def _hash_all(cloud: ArrangedCloud) -> IntArray:
    hashes = np.empty((len(cloud.keys), 2), np.int64)
    for rows in cut_even(cloud.counts, -(-len(cloud) // RECORDS_AT_ONCE)):
        records = np.ascontiguousarray(cloud.take_packed(cloud.keys[rows]).to_records())
        ends = np.cumsum(cloud.counts[rows]).tolist()
        for row, (start, end) in enumerate(pairwise([0, *ends]), rows.start):
            found = hashlib.blake2b(records[start:end].data, digest_size=16)
            hashes[row] = np.frombuffer(found.digest(), np.int64)
    return hashes
