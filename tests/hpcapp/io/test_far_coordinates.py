"""What moves all points of a file has the limit of coordinates, whatever format it comes in."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_files import MESH, NEEDED, POINTS, change_e57, change_glb, make

from hpcapp.io import drop_unusable, open_points, read_mesh, read_points, read_whole, write_mesh
from hpcapp.io.placement import parse_origin
from hpccomponent.errors import HpcError
from hpccomponent.ranges import FARTHEST

Read = Callable[[Path, float], object]


def read_glb(path: Path, x: float) -> object:
    def move(text: str) -> str:
        told = json.loads(text)
        told["nodes"] = [{"mesh": 0, "translation": [x, 0, 0]}]
        return json.dumps(told)

    path.write_bytes(change_glb(make(path), move))
    return read_mesh(path)


def read_beside(path: Path, x: float) -> object:
    path.write_bytes(make(path))
    path.with_name(f"{path.name}.origin.json").write_text(json.dumps({"origin": [0, x, 0]}))
    return read_mesh(path)


def read_las(at: int) -> Read:
    def read(path: Path, x: float) -> object:
        content = make(path)
        path.write_bytes(content[:at] + struct.pack("<d", x) + content[at + 8 :])
        return read_whole(open_points(path))

    return read


def read_e57(path: Path, x: float) -> object:
    pose = '<pose type="Structure"><translation type="Structure">'
    pose += f'<x type="Float">{x!r}</x></translation></pose>'
    path.write_bytes(change_e57(make(path), lambda xml: xml.replace("<points", f"{pose}<points")))
    return read_whole(open_points(path))


def read_ptx(line: int) -> Read:
    def read(path: Path, x: float) -> object:
        lines = make(path).decode().split("\n")
        lines[line] = f"{x!r} {lines[line].partition(' ')[2]}"
        path.write_text("\n".join(lines))
        return read_whole(open_points(path))

    return read


def read_cloud(path: Path, x: float) -> object:
    np.savetxt(path, POINTS + np.array([x, 0.0, 0.0]), "%.17g")
    return drop_unusable(read_points(path))


def read_vertices(path: Path, x: float) -> object:
    write_mesh(path, MESH)
    text = path.read_text()
    path.write_text(text.replace("v ", f"v {x!r} ") if x > FARTHEST else text)
    return read_mesh(path)


PLACES: dict[str, tuple[str, Read]] = {
    "node of a GLB": (".glb", read_glb),
    "file beside a mesh": (".stl", read_beside),
    "offset of LAS": (".las", read_las(155)),
    "scale of LAS": (".las", lambda path, x: read_las(131)(path, x / 2.0**31)),
    "pose of E57": (".e57", read_e57),
    "scanner of PTX": (".ptx", read_ptx(2)),
    "matrix of PTX": (".ptx", read_ptx(9)),
    "points of a text": (".xyz", read_cloud),
    "vertices of an OBJ": (".obj", read_vertices),
    "an option": ("", lambda _, x: parse_origin(f"0,{x!r},0")),
}


@pytest.mark.parametrize("name", PLACES)
def test_a_place_is_within_the_limit(tmp_path: Path, name: str) -> None:
    suffix, read = PLACES[name]
    if suffix in NEEDED:
        pytest.importorskip(NEEDED[suffix], reason=f"{NEEDED[suffix]} is not installed")
    read(tmp_path / f"a{suffix}", 1e9)
    for x in (4.0 * FARTHEST, 1e300, np.inf) if name == "an option" else (4.0 * FARTHEST, 1e300):
        with pytest.raises(HpcError, match=r"9e\+15|9007199254740992|float32"):
            read(tmp_path / f"b{suffix}", x)
