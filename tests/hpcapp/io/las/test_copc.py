"""Of a part of a COPC file, the nodes that reach into it are read, and the points are the same."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from copc_files import write_copc

from hpcapp.geometry.regions.prism import Prism
from hpcapp.geometry.regions.region import Area, Region
from hpcapp.io import open_points
from hpcapp.io.las.copc import find_chunks
from hpcapp.io.las.header import read_header
from hpcapp.io.points.point_source import Findings, PointSource
from hpccomponent.errors import InputError

COUNT = 120_000
AREAS: dict[str, Area] = {
    "box": Region.box(np.array([512_100.0, 5_403_100, 0]), np.array([512_120.0, 5_403_130, 99])),
    "ball": Region.ball(np.array([512_250.0, 5_403_250, 10.0]), 25.0),
    "polygon": Prism.of_text(
        "POLYGON ((512100 5403100, 512400 5403390, 512390 5403400, 512100 5403100))"
    ),
    "one with heights in feet": Region.ball(np.array([512_250.0, 5_403_250, 10.0]), 25.0, 0.3048),
    "all": Region.box(np.array([0.0, 0, -99]), np.array([1e6, 1e7, 99])),
    "the edge": Region.box(np.array([0.0, 0, -99]), np.array([512_000.5, 1e7, 99])),
}  # fmt: skip


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    random = np.random.default_rng(0)
    places = random.random((COUNT, 3)) * (500.0, 500.0, 20.0) + (512_000.0, 5_403_000.0, 0.0)
    path = tmp_path_factory.mktemp("copc") / "survey.copc.laz"
    write_copc(path, places, random.integers(1, 8, COUNT).astype(np.uint8), 4)
    return path


def read_all(source: PointSource) -> tuple[np.ndarray, np.ndarray]:
    parts = list(source.chunks(10_000))
    classes = [part.attributes["classification"] for part in parts]
    return np.concatenate([part.positions for part in parts]), np.concatenate(classes)


@pytest.mark.parametrize("area", AREAS.values(), ids=AREAS.keys())
def test_points_and_their_order_are_those_of_the_whole_file(survey: Path, area: Area) -> None:
    whole = open_points(survey)
    assert whole.octree is not None
    by_nodes = read_all(whole.within(area))
    by_all = read_all(replace(whole, octree=None).within(area))
    assert len(by_all[0])
    for one, other in zip(by_nodes, by_all, strict=True):
        np.testing.assert_array_equal(one, other)


def test_another_library_reads_the_same(survey: Path) -> None:
    with laspy.CopcReader.open(str(survey)) as reader:
        theirs = reader.query(laspy.copc.Bounds(np.array([512_100.0, 5_403_100, 0]),
                                                np.array([512_120.0, 5_403_130, 99])))  # fmt: skip
    ours, _ = read_all(open_points(survey, keeps_noise=True).within(AREAS["box"]))
    assert len(ours) == len(theirs.x)
    np.testing.assert_allclose(
        np.sort(ours[:, 0]), np.sort(np.asarray(theirs.x)), rtol=0, atol=1e-6
    )


def test_few_chunks_are_read_of_a_small_part(survey: Path) -> None:
    with survey.open("rb") as file:
        header = read_header(file, survey, Findings())
    chunks = find_chunks(survey, header, AREAS["box"])
    assert sum(chunk.points for chunk in chunks) < COUNT / 8
    everything = find_chunks(survey, header, AREAS["all"])
    assert sum(chunk.points for chunk in everything) == COUNT
    assert find_chunks(survey, header, AREAS["box"].widen(0.0)) == chunks


def test_a_place_without_points_is_told_with_the_extent(survey: Path) -> None:
    far = Region.box(np.zeros(3), np.ones(3))
    with pytest.raises(InputError, match="no points in the box") as found:
        read_all(open_points(survey).within(far))
    assert "lie from 512000" in found.value.advice
    assert "to 512499.9" in found.value.advice or "to 512500" in found.value.advice


@pytest.mark.parametrize(
    ("entry", "value", "said"),
    [
        ((0, "<i", 0), 77, "a level of it is none"),
        ((0, "<i", 0), -1, "a level of it is none"),
        ((0, "<Q", 16), 1 << 62, "hold more than the file"),
        ((0, "<i", 24), -5, "chunks overlap"),
        ((1, "<i", 24), 1 << 30, "chunks overlap"),
        ((0, "<i", 28), 1 << 30, "hold more than the file"),
        ((0, "<i", 24), 30, "cannot be decompressed"),
        ((-1, "<Q", 16), 1 << 50, "beyond the file"),
    ],
)
def test_a_damaged_octree_is_one_line(
    survey: Path, tmp_path: Path, entry: tuple[int, str, int], value: int, said: str
) -> None:
    content = bytearray(survey.read_bytes())
    at, size = struct.unpack_from("<QQ", content, 375 + 54 + 40)
    rows = list(range(at, at + size, 32))
    number, kind, offset = entry
    pages = [i for i in rows if struct.unpack_from("<i", content, i + 28)[0] == -1]
    row = pages[0] if number < 0 else rows[number]
    struct.pack_into(kind, content, row + offset, value)
    path = tmp_path / "damaged.copc.laz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_all(open_points(path).within(AREAS["all"]))


def test_pages_that_lead_to_each_other_end(survey: Path, tmp_path: Path) -> None:
    content = bytearray(survey.read_bytes())
    at, size = struct.unpack_from("<QQ", content, 375 + 54 + 40)
    struct.pack_into("<Qii", content, at + 16, at, size, -1)
    path = tmp_path / "circle.copc.laz"
    path.write_bytes(content)
    with pytest.raises(InputError, match="comes twice"):
        read_all(open_points(path).within(AREAS["all"]))
