"""E57 files with any fields, poses and numbers of scans, written by libE57."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

libe57 = pytest.importorskip("pye57.libe57", reason="pye57 is not installed")

MakeE57 = Callable[..., Path]


@dataclass(frozen=True)
class ScanToWrite:
    """A scan: values of its fields by name, and what its header states."""

    fields: dict[str, object]
    rotation: tuple[float, ...] | None = None
    translation: tuple[float, ...] | None = None
    numbers: dict[str, dict[str, float]] = field(default_factory=dict)


def structure(image: object, numbers: dict[str, float]) -> object:
    node = libe57.StructureNode(image)
    for name, value in numbers.items():
        kind = libe57.IntegerNode if isinstance(value, int) else libe57.FloatNode
        node.set(name, kind(image, value))
    return node


def add_scan(image: Any, scans: Any, scan: ScanToWrite) -> None:
    node = libe57.StructureNode(image)
    node.set("guid", libe57.StringNode(image, "{1}"))
    if scan.rotation is not None or scan.translation is not None:
        pose = libe57.StructureNode(image)
        for name, axes in (("rotation", "wxyz"), ("translation", "xyz")):
            values = getattr(scan, name)
            if values is not None:
                pose.set(name, structure(image, dict(zip(axes, values, strict=True))))
        node.set("pose", pose)
    for name, numbers in scan.numbers.items():
        node.set(name, structure(image, numbers))
    columns = {name: np.ascontiguousarray(values) for name, values in scan.fields.items()}
    prototype = libe57.StructureNode(image)
    for name, values in columns.items():
        if values.dtype.kind == "f":
            prototype.set(name, libe57.FloatNode(image, 0.0, libe57.E57_DOUBLE))
        else:
            limits = np.iinfo(values.dtype)
            prototype.set(name, libe57.IntegerNode(image, 0, int(limits.min), int(limits.max)))
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    node.set("points", points)
    scans.append(node)
    buffers = libe57.VectorSourceDestBuffer()
    count = len(next(iter(columns.values())))
    # pye57 takes no integers of four bytes: numbers are handed over as floats.
    held = {name: values.astype(np.float64) for name, values in columns.items()}
    for name, values in held.items():
        buffers.append(libe57.SourceDestBuffer(image, name, values, count, True, True))
    writer = points.writer(buffers)
    if count:
        writer.write(count)
    writer.close()


@pytest.fixture
def make_e57(tmp_path: Path) -> MakeE57:
    """Give a function that writes a file of some scans."""

    def make(*scans: ScanToWrite, name: str = "a.e57", crs: str | None = None) -> Path:
        path = tmp_path / name
        with closing(libe57.ImageFile(str(path), "w")) as image:
            image.extensionsAdd("", libe57.E57_V1_0_URI)
            image.extensionsAdd("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")
            root = image.root()
            root.set("formatName", libe57.StringNode(image, "ASTM E57 3D Imaging Data File"))
            root.set("guid", libe57.StringNode(image, "{0}"))
            root.set("versionMajor", libe57.IntegerNode(image, libe57.E57_FORMAT_MAJOR))
            root.set("versionMinor", libe57.IntegerNode(image, libe57.E57_FORMAT_MINOR))
            if crs is not None:
                root.set("coordinateMetadata", libe57.StringNode(image, crs))
            vector = libe57.VectorNode(image, True)
            root.set("data3D", vector)
            root.set("images2D", libe57.VectorNode(image, True))
            for scan in scans:
                add_scan(image, vector, scan)
        return path

    return make


def coordinates(positions: Sequence[Sequence[float]]) -> dict[str, object]:
    columns = np.array(positions, np.float64).reshape(-1, 3).T
    return {f"cartesian{axis}": columns[i] for i, axis in enumerate("XYZ")}


@pytest.fixture
def scan() -> Callable[..., ScanToWrite]:
    """Give a function that makes a scan of positions, other fields and what its header states."""

    def make(positions: Sequence[Sequence[float]], **stated: Any) -> ScanToWrite:
        fields = {**coordinates(positions), **stated.pop("fields", {})}
        return ScanToWrite(fields, **stated)

    return make
