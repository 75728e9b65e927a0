from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.mesh import Mesh
from hpcapp.io.meshes.threemf import write_3mf

CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
MATERIAL = "{http://schemas.microsoft.com/3dmanufacturing/material/2015/02}"


def read_model(path: Path) -> ElementTree.Element:
    with ZipFile(path) as package:
        assert package.testzip() is None
        names = set(package.namelist())
        assert names == {"[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"}
        links = ElementTree.fromstring(package.read("_rels/.rels"))  # noqa: S314 - our own file
        assert links[0].get("Target") == "/3D/3dmodel.model"
        return ElementTree.fromstring(package.read("3D/3dmodel.model"))  # noqa: S314


def numbers(rows: list[ElementTree.Element], names: str) -> NDArray[np.generic]:
    return np.array([[float(row.attrib[name]) for name in names.split()] for row in rows])


def test_a_plain_mesh_comes_back(tmp_path: Path, tetrahedron: Mesh) -> None:
    write_3mf(tmp_path / "mesh.3mf", tetrahedron)
    model = read_model(tmp_path / "mesh.3mf")
    places = numbers(list(model.iter(f"{CORE}vertex")), "x y z")
    np.testing.assert_array_equal(places, tetrahedron.vertices)
    faces = numbers(list(model.iter(f"{CORE}triangle")), "v1 v2 v3")
    np.testing.assert_array_equal(faces, tetrahedron.faces)
    (item,) = model.iter(f"{CORE}item")
    assert "transform" not in item.attrib


def test_colours_and_origin_are_kept(tmp_path: Path, painted: Mesh) -> None:
    write_3mf(tmp_path / "mesh.3mf", painted)
    model = read_model(tmp_path / "mesh.3mf")
    palette = [row.attrib["color"] for row in model.iter(f"{MATERIAL}color")]
    assert painted.colours is not None
    names = [f"#{red:02X}{green:02X}{blue:02X}" for red, green, blue in painted.colours.tolist()]
    wanted = [[names[vertex] for vertex in face] for face in painted.faces.tolist()]
    rows = numbers(list(model.iter(f"{CORE}triangle")), "p1 p2 p3").astype(int)
    assert [[palette[number] for number in row] for row in rows] == wanted
    (item,) = model.iter(f"{CORE}item")
    moved = np.array(item.attrib["transform"].split(), float).reshape(4, 3)
    np.testing.assert_array_equal(moved, [*np.eye(3), painted.origin])


def test_the_same_mesh_gives_the_same_bytes(tmp_path: Path, painted: Mesh) -> None:
    for name in ("a.3mf", "b.3mf"):
        write_3mf(tmp_path / name, painted)
    assert (tmp_path / "a.3mf").read_bytes() == (tmp_path / "b.3mf").read_bytes()
