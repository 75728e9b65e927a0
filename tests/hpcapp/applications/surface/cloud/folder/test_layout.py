"""Points in a file take few bytes, and come back bit for bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from disk_clouds import read_part
from numpy.typing import NDArray

from hpcapp.applications.surface.cloud.arrangement import Arrangement, PackedPoints, pack_points
from hpcapp.applications.surface.cloud.folder.parts import write_part
from hpccomponent.files.checksum import PAGE
from hpccomponent.store.value import DamagedError

POINTS = 20_000


def unit(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths: NDArray[np.float64] = np.sqrt((normals * normals).sum(axis=1))[:, None]
    return normals / np.maximum(lengths, 1e-300)


def kinds() -> dict[str, tuple[NDArray[np.floating], int]]:
    """Return normals as they come from files, and how many bytes a point takes with them."""
    random = np.random.default_rng(3)
    plain = unit(random.normal(size=(POINTS, 3)))
    single = plain.astype(np.float32)
    single /= np.sqrt((single * single).sum(axis=1, dtype=np.float32))[:, None]
    odd = plain.astype(np.float32)
    odd[:4] = [[0.0, -0.0, 1.0], [np.nan, 0.0, -1.0], [np.inf, 1.0, 0.0], [0.0, 0.0, 0.0]]
    odd[4:8] = np.float32(1e-45)
    return {
        "made in double precision": (plain, 17),
        "made in single precision": (single, 17),
        "kept as bytes": (unit(np.round(127.0 * plain)), 17),
        "of a wall": (np.tile([0.0, -1.0, 0.0], (POINTS, 1)), 9),
        "missing": (np.zeros((POINTS, 3)), 9),
        "of any lengths": (plain * random.random((POINTS, 1)), 21),
        "odd": (odd, 21),
    }


def write(folder: Path, normals: NDArray[np.floating]) -> tuple[PackedPoints, bytes]:
    positions = np.random.default_rng(4).random((POINTS, 3))
    packed = pack_points(Arrangement(np.zeros(3), 0.25), positions, normals.astype(np.float64))
    write_part(folder, 0, [packed])
    return packed, (folder / "points.0").read_bytes()


@pytest.mark.parametrize("kind", kinds())
def test_records_come_back_bit_for_bit(tmp_path: Path, kind: str) -> None:
    normals, size = kinds()[kind]
    packed, written = write(tmp_path, normals)
    assert read_part(tmp_path / "points.0", POINTS).tobytes() == packed.to_records().tobytes()
    assert size - 1 <= (len(written) - PAGE) / POINTS <= size + 0.01


def test_a_part_of_blocks_that_are_empty(tmp_path: Path) -> None:
    """All of their points were dropped."""
    none = np.empty((0, 6), np.float32)
    empty = PackedPoints.from_records(np.array([5, 9]), np.zeros(2, np.int64), none)
    keys, counts = write_part(tmp_path, 0, [empty])
    assert (keys.tolist(), counts.tolist()) == ([5, 9], [0, 0])
    assert len(read_part(tmp_path / "points.0", 0)) == 0


def test_what_is_no_part_is_refused(tmp_path: Path) -> None:
    (tmp_path / "points.0").write_bytes(b"hpcfold1")
    with pytest.raises(DamagedError, match="does not begin as packed points do"):
        read_part(tmp_path / "points.0", 1)
