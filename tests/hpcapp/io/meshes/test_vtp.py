from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.geometry.mesh import Mesh
from hpcapp.io.meshes.vtp import write_vtp


def read_vtp(path: Path) -> tuple[ElementTree.Element, dict[str, NDArray[np.generic]]]:
    """Return the piece, and the arrays by name, as VTK reads them."""
    raw = path.read_bytes()
    head, _, body = raw.partition(b'<AppendedData encoding="raw">\n_')
    root = ElementTree.fromstring(head + b"</VTKFile>")  # noqa: S314 - it is our own
    assert root.attrib["header_type"] == "UInt64"
    piece = root.find("PolyData/Piece")
    assert piece is not None
    found, end = {}, 0
    for array in piece.iter("DataArray"):
        kind = array.attrib["type"]
        letter = {"I": "i", "U": "u", "F": "f"}[kind[0]]
        dtype = np.dtype(f"<{letter}{int(kind.lstrip('UIntFloa')) // 8}")
        start = int(array.attrib["offset"])
        size = int(np.frombuffer(body, "<u8", 1, start)[0])
        values = np.frombuffer(body, dtype, size // dtype.itemsize, start + 8)
        components = int(array.attrib["NumberOfComponents"])
        found[array.attrib["Name"]] = values if components == 1 else values.reshape(-1, components)
        end = max(end, start + 8 + size)
    assert body[end:] == b"\n</AppendedData>\n</VTKFile>\n"
    return piece, found


def test_a_mesh_with_everything_comes_back(tmp_path: Path, painted: Mesh) -> None:
    write_vtp(tmp_path / "mesh.vtp", painted)
    piece, found = read_vtp(tmp_path / "mesh.vtp")
    assert (piece.attrib["NumberOfPoints"], piece.attrib["NumberOfPolys"]) == ("4", "4")
    assert found["Points"].dtype == np.float64
    np.testing.assert_array_equal(found["Points"], painted.vertices + painted.origin)
    np.testing.assert_array_equal(found["connectivity"].reshape(-1, 3), painted.faces)
    assert found["offsets"].tolist() == [3, 6, 9, 12]
    np.testing.assert_array_equal(found["RGB"], painted.colours)
    assert painted.normals is not None
    np.testing.assert_array_equal(found["Normals"], painted.normals.astype(np.float32))
    for name, column in painted.attributes.items():
        np.testing.assert_array_equal(found[name], column)
    kinds = {name: found[name].dtype.str for name in painted.attributes}
    assert kinds == {
        "intensity": "<u2", "gps time": "<f8", "is <good>": "|u1", "number": "<i8", "half": "<f4",
    }  # fmt: skip


def test_a_plain_mesh_is_places_and_faces(tmp_path: Path, tetrahedron: Mesh) -> None:
    write_vtp(tmp_path / "mesh.vtp", tetrahedron)
    _, found = read_vtp(tmp_path / "mesh.vtp")
    assert set(found) == {"Points", "connectivity", "offsets"}
    assert found["Points"].dtype == np.float32


@pytest.mark.parametrize("rows", [1, 3])
def test_blocks_of_any_size_give_the_same_file(
    tmp_path: Path, painted: Mesh, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_vtp(tmp_path / "whole.vtp", painted)
    monkeypatch.setattr("hpcapp.io.meshes.mesh_stream._ROWS_AT_ONCE", rows)
    write_vtp(tmp_path / "blocks.vtp", painted)
    assert (tmp_path / "blocks.vtp").read_bytes() == (tmp_path / "whole.vtp").read_bytes()
