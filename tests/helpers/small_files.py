"""A small file of each format that is read, and changes to its head that leave it whole."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mutated_files import page_e57, read_pages

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_mesh, write_points
from hpcapp.io.registry import FORMATS

POINTS = np.random.default_rng(1).normal(size=(60, 3)).astype(np.float32).astype(np.float64)
MESH = Mesh(POINTS, np.arange(60).reshape(20, 3))
ROWS = "".join("{:.6f} {:.6f} {:.6f}\n".format(*point) for point in POINTS.tolist())
NEEDED = {".las": "laspy", ".laz": "lazrs", ".e57": "pye57"}
PLY = (
    "ply\nformat binary_little_endian 1.0\nobj_info num_cols 4\nobj_info num_rows 3\n"
    "element vertex 60\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 20\nproperty list uchar int vertex_indices\n"
    "element range_grid 12\nproperty list uchar int vertex_indices\nend_header\n"
)
PCD = (
    "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {0}\nHEIGHT 1\n"
    "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {0}\nDATA {1}\n"
)
VTK = (
    "# vtk DataFile Version 3.0\nt\nBINARY\nDATASET POLYDATA\nPOINTS 60 float\n{}"
    "POLYGONS 1 4\n{}POINT_DATA 60\nSCALARS a float 1\nLOOKUP_TABLE default\n{}\n"
)


def make(path: Path) -> bytes:
    """Return the bytes of a small file that is as it should be."""
    single = POINTS.astype("<f4").tobytes()
    faces = np.insert(MESH.faces.astype("<i4").view("u1").reshape(20, 12), 0, 3, axis=1).tobytes()
    match path.suffix:
        case ".ply":
            return PLY.encode() + single + faces + bytes(12)
        case ".pcd":
            return PCD.format(60, "binary").encode() + single
        case ".vtk":
            parts = (POINTS.astype(">f4").tobytes(), struct.pack(">4i", 3, 0, 1, 2), bytes(240))
            return VTK.format(*(part.decode("latin-1") for part in parts)).encode("latin-1")
        case ".ptx":
            pose = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
            return f"6\n10\n{pose}{ROWS.replace(chr(10), ' 0.5' + chr(10))}".encode()
        case ".npy":
            saved = io.BytesIO()
            np.save(saved, POINTS)
            return saved.getvalue()
        case ".las" | ".laz" | ".e57" | ".npz":
            write_points(path, PointCloud(POINTS))
        case suffix if any(suffix in one.suffixes and one.mesh_writer for one in FORMATS):
            write_mesh(path, MESH)
        case ".csv":
            return b"x,y,z\n" + ROWS.replace(" ", ",").encode()
        case ".xyzn" | ".xyzrgb" | ".pwn":
            return "".join(f"{row} 0 0 1\n" for row in ROWS.splitlines()).encode()
        case ".xyzi":
            return "".join(f"{row} 7\n" for row in ROWS.splitlines()).encode()
        case _:
            return f"60\n{ROWS}".encode()
    content = path.read_bytes()
    return change_glb(content, add_nodes) if path.suffix == ".glb" else content


def add_nodes(text: str) -> str:
    """Give a glTF nodes within each other, and what its own views and accessors need not say."""
    told = json.loads(text)
    told["nodes"].append({"mesh": 0, "translation": [9, 9, 9], "rotation": [0, 0, 0, 1]})
    told["nodes"].append({"mesh": 0, "scale": [1, 2, 3], "children": [1]})
    told["nodes"][0]["children"] = [2]
    told["bufferViews"][0]["byteStride"] = 12
    for accessor in told["accessors"]:
        accessor["byteOffset"] = 0
    return json.dumps(told)


def change_glb(content: bytes, change: Callable[[str], str]) -> bytes:
    length = int.from_bytes(content[12:16], "little")
    text = change(content[20 : 20 + length].decode()).encode()
    text += b" " * (-len(text) % 4)
    rest = struct.pack("<I", len(text)) + b"JSON" + text + content[20 + length :]
    return content[:8] + struct.pack("<I", 12 + len(rest)) + rest


def change_e57(content: bytes, change: Callable[[str], str]) -> bytes:
    held = read_pages(content)
    place, length = struct.unpack_from("<QQ", held, 24)
    start = place // 1024 * 1020 + place % 1024
    text = change(held[start : start + length].decode()).encode()
    held[start:] = text
    struct.pack_into("<Q", held, 16, -(-len(held) // 1020) * 1024)
    struct.pack_into("<Q", held, 32, len(text))
    return page_e57(held)


def change_head(content: bytes, change: Callable[[str], str], end: bytes) -> bytes:
    at = content.index(end)
    return change(content[:at].decode("latin-1")).encode("latin-1") + content[at:]
