"""What a file announces is compared with what is there, in every format that announces it.

Fewer points are refused. More are told, and left out; text reads them. Where sections that follow
the points cannot be told from more points, the file is refused.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mutated_files import page_e57, read_pages

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import open_points, read_mesh, read_whole, write_mesh, write_points
from hpccomponent.errors import InputError

COUNT, MORE, FEWER = 1000, 2000, 500
POINTS = np.random.default_rng(1).normal(size=(COUNT, 3)).astype(np.float32).astype(np.float64)
LINES = "".join("{:.6f} {:.6f} {:.6f}\n".format(*point) for point in POINTS)
FACES = np.arange(999).reshape(333, 3)
BLOCK = POINTS.astype("<f4").tobytes()

Make = Callable[[Path, int], bytes]


def ply(coding: str, body: bytes) -> Make:
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat {coding} 1.0\nelement vertex {{}}\n{properties}end_header\n"
    return lambda _, count: head.format(count).encode() + body


def pcd(coding: str, body: bytes) -> Make:
    head = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {0}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {{0}}\nDATA {coding}\n"
    )
    return lambda _, count: head.format(count).encode() + body


def vtk(coding: str, body: bytes) -> Make:
    head = f"# vtk DataFile Version 3.0\nt\n{coding}\nDATASET POLYDATA\nPOINTS {{}} float\n"
    return lambda _, count: head.format(count).encode() + body


def text(head: str, end: str = "\n") -> Make:
    return lambda _, count: (head.format(count, count // 10) + LINES.replace("\n", end)).encode()


def npy(_: Path, count: int) -> bytes:
    saved = io.BytesIO()
    np.save(saved, POINTS)
    return saved.getvalue().replace(b"(1000, 3)", b"(%4d, 3)" % count)


def npz(path: Path, count: int) -> bytes:
    saved = io.BytesIO()
    with zipfile.ZipFile(saved, "w") as archive:
        archive.writestr("points.npy", npy(path, count))
    return saved.getvalue()


def las(path: Path, count: int) -> bytes:
    write_points(path, PointCloud(POINTS))
    content = bytearray(path.read_bytes())
    struct.pack_into("<Q", content, 247, count)
    return bytes(content)


def e57(path: Path, count: int) -> bytes:
    write_points(path, PointCloud(POINTS))
    held = read_pages(path.read_bytes())
    return page_e57(held.replace(b'recordCount="1000"', b'recordCount="%4d"' % count))


def off(_: Path, count: int) -> bytes:
    faces = "".join("3 {} {} {}\n".format(*face) for face in FACES)
    return f"OFF\n1000 {count // 3} 0\n{LINES}{faces}".encode()


def stl(_: Path, count: int) -> bytes:
    triangles = np.zeros(333, [("normal", "<f4", 3), ("corners", "<f4", 9), ("attribute", "<u2")])
    triangles["corners"] = POINTS[:999].reshape(333, 9)
    return bytes(80) + struct.pack("<I", count // 3) + triangles.tobytes()


def vtp(name: str) -> Make:
    def make(path: Path, count: int) -> bytes:
        write_mesh(path, Mesh(POINTS, FACES))
        before = {"Points": 1000, "Polys": 333}[name]
        stated = f'NumberOf{name}="{before}"'.encode()
        content = path.read_bytes()
        assert stated in content
        return content.replace(stated, f'NumberOf{name}="{before * count // COUNT}"'.encode())

    return make


def glb(what: str) -> Make:
    def make(path: Path, count: int) -> bytes:
        write_mesh(path, Mesh(POINTS, FACES))
        content = path.read_bytes()
        if what == "bytes":
            return content[:8] + struct.pack("<I", len(content) * count // COUNT) + content[12:]
        length = int.from_bytes(content[12:16], "little")
        told = json.loads(content[20 : 20 + length])
        one = told["meshes"][0]["primitives"][0]
        number = one["indices"] if what == "indices" else one["attributes"]["POSITION"]
        told["accessors"][number]["count"] *= count // COUNT
        words = json.dumps(told).encode()
        words += b" " * (-len(words) % 4)
        rest = struct.pack("<II", len(words), 0x4E4F534A) + words + content[20 + length :]
        return struct.pack("<4sII", b"glTF", 2, 12 + len(rest)) + rest

    return make


PTX = "{1}\n10\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
CLOUDS: dict[str, tuple[str, Make]] = {
    "PLY, ascii": (".ply", ply("ascii", LINES.encode())),
    "PLY": (".ply", ply("binary_little_endian", BLOCK)),
    "PCD, ascii": (".pcd", pcd("ascii", LINES.encode())),
    "PCD": (".pcd", pcd("binary", BLOCK)),
    "VTK, ascii": (".vtk", vtk("ASCII", LINES.encode())),
    "VTK": (".vtk", vtk("BINARY", POINTS.astype(">f4").tobytes())),
    "PTS": (".pts", text("{}\n")),
    "text": (".xyz", text("{}\n")),
    "PTX": (".ptx", text(PTX, " 0.5\n")),
    "NPY": (".npy", npy),
    "NPZ": (".npz", npz),
    "OFF": (".off", off),
    "STL": (".stl", stl),
    "LAS": (".las", las),
    "LAZ": (".laz", las),
    "E57": (".e57", e57),
}
MESHES: dict[str, tuple[str, Make]] = {
    "OFF": (".off", off),
    "STL": (".stl", stl),
    "VTP, points": (".vtp", vtp("Points")),
    "VTP, polygons": (".vtp", vtp("Polys")),
    "GLB, bytes": (".glb", glb("bytes")),
    "GLB, vertices": (".glb", glb("vertices")),
    "GLB, indices": (".glb", glb("indices")),
}
REFUSE_MORE = {"VTK, ascii", "VTK", "PTX", "OFF", "STL"}
READ_MORE = {"PTS", "text"}


def skip_without_library(name: str) -> None:
    for library in {"LAS": ["laspy"], "LAZ": ["laspy", "lazrs"], "E57": ["pye57"]}.get(name, []):
        pytest.importorskip(library, reason=f"{library} is not installed")


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("announced", [COUNT, MORE, FEWER])
def test_points(tmp_path: Path, name: str, announced: int) -> None:
    skip_without_library(name)
    suffix, make = CLOUDS[name]
    path = tmp_path / f"a{suffix}"
    path.write_bytes(make(path, announced))
    if announced == MORE or (announced == FEWER and name in REFUSE_MORE):
        with pytest.raises(InputError) as caught:
            read_whole(open_points(path))
        numbers = [str(count) for count in (announced, announced // 3, 3 * announced)]
        assert announced == FEWER or any(number in str(caught.value) for number in numbers)
        return
    source = open_points(path)
    read = len(read_whole(source))
    if announced == COUNT:
        assert read >= COUNT - 1  # a mesh of triangles has a corner less
        assert not source.findings.warnings
    else:
        assert read == (COUNT if name in READ_MORE else FEWER)
        [warning] = source.findings.warnings
        assert str(FEWER) in warning or any(str(size * FEWER) in warning for size in (12, 24))


@pytest.mark.parametrize("name", MESHES)
def test_meshes(tmp_path: Path, name: str) -> None:
    suffix, make = MESHES[name]
    path = tmp_path / f"a{suffix}"
    path.write_bytes(make(path, COUNT))
    assert len(read_mesh(path).faces) == 333
    path.write_bytes(make(path, MORE))
    with pytest.raises(InputError):
        read_mesh(path)
