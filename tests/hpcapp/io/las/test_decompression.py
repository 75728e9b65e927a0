"""Compressed points: the libraries, and what a damaged file can ask of them."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from shared_data import shared

from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpcapp.io.las.points import open_las
from hpccomponent.errors import InputError, MissingLibraryError

pytest.importorskip("laspy", reason="laspy is not installed")
pytest.importorskip("lazrs", reason="lazrs is not installed")


@pytest.fixture
def laz(tmp_path: Path) -> Path:
    """120,000 points with colours: three chunks of seven layers and more."""
    random = np.random.default_rng(3)
    colours = random.integers(0, 256, (120_000, 3)).astype(np.uint8)
    path = tmp_path / "a.laz"
    write_points(path, PointCloud(random.normal(size=(120_000, 3)), None, colours))
    return path


def read(path: Path, rows: int = 50_000) -> PointCloud:
    parts = list(open_las(path).chunks(rows))
    return PointCloud(np.concatenate([part.positions for part in parts]))


@pytest.mark.parametrize("rows", [7_001, 50_000, 1 << 20])
def test_parts_are_the_whole(laz: Path, rows: int) -> None:
    plain = laz.with_suffix(".las")
    random = np.random.default_rng(3)
    colours = random.integers(0, 256, (120_000, 3)).astype(np.uint8)
    write_points(plain, PointCloud(random.normal(size=(120_000, 3)), None, colours))
    assert read(laz, rows).positions.tobytes() == read(plain).positions.tobytes()


def test_laszip_reads_the_same(laz: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("laszip", reason="laszip is not installed")
    expected = read(laz).positions
    monkeypatch.setitem(sys.modules, "lazrs", None)
    assert read(laz).positions.tobytes() == expected.tobytes()


def test_no_library(laz: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for library in ("lazrs", "laszip"):
        monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(
        MissingLibraryError, match=r"need the package lazrs; .* -m pip install 'laspy\["
    ):
        open_las(laz)


def damage(path: Path, at: int, value: bytes) -> None:
    content = bytearray(path.read_bytes())
    content[at : at + len(value)] = value
    path.write_bytes(content)


def points_start(path: Path) -> int:
    return int.from_bytes(path.read_bytes()[96:100], "little")


def table_at(path: Path) -> int:
    start = points_start(path)
    return int.from_bytes(path.read_bytes()[start : start + 8], "little")


def test_place_of_the_table_at_the_end(laz: Path) -> None:
    expected, place = read(laz).positions, table_at(laz)
    damage(laz, points_start(laz), struct.pack("<q", -1))
    laz.write_bytes(laz.read_bytes() + struct.pack("<q", place))
    assert read(laz).positions.tobytes() == expected.tobytes()


def record_at(path: Path) -> int:
    return path.read_bytes().index(b"laszip encoded") + 52


@pytest.mark.parametrize(
    ("place", "content", "said"),
    [
        (points_start, struct.pack("<q", 3), "it has no table of chunks"),
        (lambda path: table_at(path) + 4, struct.pack("<I", 1 << 31),
         "its table announces 2147483648 chunks"),
        (lambda path: points_start(path) + 8 + 36 + 4, b"\xff\xff\xff\x7f",
         "its layers are longer than their chunk"),
        (lambda _: 105, struct.pack("<H", 40), "does not fit the points"),
        (lambda _: 247, struct.pack("<Q", 1 << 40), f"its chunks hold 150000 of {1 << 40} points"),
        (lambda _: 247, struct.pack("<Q", 140_000), r"\(100000 of 140000 points were read\)"),
        (lambda path: record_at(path) + 12, struct.pack("<I", 0x7F000000),
         "a chunk of it holds 2130706432 points, the file 120000"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_points_is_named(
    laz: Path, place: Callable[[Path], int], content: bytes, said: str
) -> None:
    damage(laz, place(laz), content)
    with pytest.raises(InputError, match=said):
        read(laz)


def test_a_part_keeps_its_points(laz: Path) -> None:
    """The memory that is decompressed into is used again."""
    parts = open_las(laz).chunks(1)
    first, second = next(parts), next(parts)
    parts.close()  # type: ignore[attr-defined]
    assert first.colours is not None
    assert second.colours is not None
    assert first.colours.tolist() != second.colours.tolist()


@pytest.mark.parametrize("share", [0.1, 0.5, 0.999])
def test_cut(laz: Path, share: float) -> None:
    laz.write_bytes(laz.read_bytes()[: int(share * laz.stat().st_size)])
    with pytest.raises(InputError):
        read(laz)


@pytest.mark.parametrize("seed", range(40))
def test_flipped_bytes(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "a.laz"
    write_points(path, PointCloud(np.random.default_rng(seed).normal(size=(300, 3))))
    content = bytearray(path.read_bytes())
    random = np.random.default_rng(seed)
    for at in random.integers(0, len(content), 4):
        content[at] = random.integers(0, 256)
    path.write_bytes(content)
    with suppress(InputError):
        read(path)


def test_oldest_compressor(capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("laszip", reason="laszip is not installed")
    path = shared("real/las/simple-laszip-compressor-version-1.2r0.laz")
    positions = read(path, 100).positions
    assert len(positions) == 1065
    np.testing.assert_allclose(positions[-1], [637342.85, 853240.32, 423.92], atol=1e-6)
    assert capfd.readouterr() == ("", "")
