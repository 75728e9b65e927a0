"""A light mesh with a texture, of a known surface in known colours: judged by what is seen."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from PIL import Image

from hpcapp.applications.surface.cli.command import reconstruct
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import read_mesh, write_points
from hpcapp.texture.bake import choose_step
from hpccomponent.errors import HpcError, MissingLibraryError, UsageError

POINTS, FACES, PIXELS = 40_000, 600, 512


def paint(places: FloatArray) -> FloatArray:
    """Smooth colours, 0 to 255, of places on the unit sphere: six waves around it."""
    return 127.5 * (1.0 + np.sin(6.0 * places))


@pytest.fixture(scope="module")
def sphere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directions = np.random.default_rng(5).normal(size=(POINTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    path = tmp_path_factory.mktemp("sphere") / "sphere.ply"
    write_points(path, PointCloud(directions, directions, np.rint(paint(directions)).astype("u1")))
    return path


def run(points: Path, output: Path, *words: str) -> dict[str, Any]:
    arguments = [str(points), "-o", str(output), "--backend", "serial", "--json", *words]
    done = CliRunner().invoke(reconstruct, arguments, catch_exceptions=False)
    assert done.exit_code == 0
    return dict(json.loads(done.stdout))


@pytest.fixture(scope="module")
def textured(sphere: Path) -> Path:
    output = sphere.parent / "sphere.glb"
    report = run(sphere, output, "--faces", str(FACES), "--texture", str(PIXELS))
    assert report["texture"]["pixels"] == PIXELS
    assert report["texture"]["filled"] > 0.4
    assert report["faces"] == FACES
    return output


class Glb:
    """What a viewer finds in a GLB."""

    def __init__(self, path: Path) -> None:
        raw = path.read_bytes()
        size = int.from_bytes(raw[12:16], "little")
        self.document = json.loads(raw[20 : 20 + size])
        self.body = raw[28 + size :]
        assert len(self.body) == self.document["buffers"][0]["byteLength"]
        (primitive,) = self.document["meshes"][0]["primitives"]
        self.columns = {name: self._rows(n) for name, n in primitive["attributes"].items()}
        self.faces = self._rows(primitive["indices"]).reshape(-1, 3)
        material = self.document["materials"][primitive["material"]]
        self.colours = self._picture(material["pbrMetallicRoughness"].get("baseColorTexture"))
        self.normals = self._picture(material["normalTexture"])

    def _view(self, number: int) -> bytes:
        view = self.document["bufferViews"][number]
        return self.body[view["byteOffset"] :][: view["byteLength"]]

    def _rows(self, number: int) -> NDArray[Any]:
        accessor = self.document["accessors"][number]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        dtype = {5125: "<u4", 5126: "<f4"}[accessor["componentType"]]
        return np.frombuffer(self._view(accessor["bufferView"]), dtype).reshape(-1, width)

    def _picture(self, owner: dict[str, int] | None) -> NDArray[Any]:
        if owner is None:
            return np.empty((0, 0, 3))
        image = self.document["images"][self.document["textures"][owner["index"]]["source"]]
        return np.asarray(Image.open(BytesIO(self._view(image["bufferView"]))), np.float64)

    def sample(self, weights: FloatArray) -> dict[str, FloatArray]:
        """Return what is seen at the same place of each face, texels blended as a viewer does."""
        rows = {name: np.einsum("c,fcw->fw", weights, column[self.faces].astype(float))
                for name, column in self.columns.items()}  # fmt: skip
        found = {"places": rows["POSITION"], "colours": _blend(self.colours, rows["TEXCOORD_0"])}
        out = rows["NORMAL"] / np.linalg.norm(rows["NORMAL"], axis=1, keepdims=True)
        right = rows["TANGENT"][:, :3]
        right = right / np.linalg.norm(right, axis=1, keepdims=True)
        up = np.cross(out, right) * np.sign(rows["TANGENT"][:, 3:])
        local = _blend(self.normals, rows["TEXCOORD_0"]) / 127.5 - 1.0
        seen = local[:, :1] * right + local[:, 1:2] * up + local[:, 2:] * out
        found["normals"] = seen / np.linalg.norm(seen, axis=1, keepdims=True)
        found["flat"] = out
        return found


def _blend(picture: NDArray[Any], places: FloatArray) -> FloatArray:
    """Look texels up between their middles."""
    if not picture.size:
        return np.empty((len(places), 0))
    at = places * picture.shape[0] - 0.5
    low = np.floor(at).astype(int)
    share = at - low
    total = np.zeros((len(places), 3))
    for down in (0, 1):
        for right in (0, 1):
            weight = np.abs(1 - right - share[:, 0]) * np.abs(1 - down - share[:, 1])
            rows, columns = (np.clip(low[:, i] + d, 0, len(picture) - 1)
                             for i, d in ((1, down), (0, right)))  # fmt: skip
            total += weight[:, None] * picture[rows, columns]
    return total


def test_charts_do_not_open_a_closed_mesh(textured: Path) -> None:
    assert check_mesh(read_mesh(textured)).watertight


def errors(found: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return how wrong colours are, of 255, and normals, in degrees."""
    truth = found["places"] / np.linalg.norm(found["places"], axis=1, keepdims=True)
    colours = np.abs(found["colours"] - paint(truth)).max(axis=1)
    cosines = np.clip((found["normals"] * truth).sum(axis=1), -1.0, 1.0)
    return colours, np.degrees(np.arccos(cosines))


@pytest.mark.parametrize("weights", [(1 / 3, 1 / 3, 1 / 3), (0.6, 0.3, 0.1), (0.02, 0.03, 0.95)])
def test_colours_and_normals_are_those_of_the_scan(
    textured: Path, weights: tuple[float, float, float]
) -> None:
    found = Glb(textured).sample(np.array(weights))
    colours, normals = errors(found)
    assert np.median(colours) < 4.0
    assert np.quantile(colours, 0.99) < 25.0
    assert np.median(normals) < 1.5
    assert np.quantile(normals, 0.99) < 6.0


def test_vertices_alone_would_show_less(sphere: Path, textured: Path) -> None:
    """Faces of .17 of the radius: their corners say little of waves of one."""
    run(sphere, sphere.parent / "plain.ply", "--faces", str(FACES))
    plain = read_mesh(sphere.parent / "plain.ply")
    assert plain.colours is not None
    middles = plain.vertices[plain.faces].mean(axis=1)
    truth = paint(middles / np.linalg.norm(middles, axis=1, keepdims=True))
    by_vertices = np.abs(plain.colours[plain.faces].mean(axis=1) - truth).max(axis=1)
    by_texture, _ = errors(Glb(textured).sample(np.full(3, 1 / 3)))
    assert np.median(by_texture) < 0.3 * np.median(by_vertices)


def test_no_seam_shows_where_charts_meet(textured: Path) -> None:
    """An edge that is in two charts has the same colours on either side."""
    glb = Glb(textured)
    places = glb.columns["POSITION"]
    sides: dict[tuple[bytes, ...], list[tuple[int, int]]] = {}
    for face in glb.faces.tolist():
        for one, other in zip(face, face[1:] + face[:1], strict=True):
            ends = sorted([(places[one].tobytes(), one), (places[other].tobytes(), other)])
            sides.setdefault(tuple(place for place, _ in ends), []).append((ends[0][1], ends[1][1]))
    seams = [both for both in sides.values() if len(both) == 2 and both[0] != both[1]]
    assert len(seams) > 20
    uv = glb.columns["TEXCOORD_0"].astype(float)
    middles = np.array([[uv[list(ends)].mean(axis=0) for ends in both] for both in seams])
    left, right = (_blend(glb.colours, middles[:, side]) for side in (0, 1))
    assert np.quantile(np.abs(left - right).max(axis=1), 0.99) < 16.0


def test_an_obj_has_the_same_pictures_beside_it(sphere: Path, tmp_path: Path) -> None:
    output = tmp_path / "my sphere.obj"
    run(sphere, output, "--faces", str(FACES), "--texture", str(PIXELS))
    names = {"my sphere.obj", "my~20sphere.mtl", "my~20sphere_colours.png",
             "my~20sphere_normals.png"}  # fmt: skip
    assert {path.name for path in tmp_path.iterdir()} == names
    text = output.read_text()
    assert "mtllib my~20sphere.mtl\n" in text
    assert "map_Kd my~20sphere_colours.png\n" in (tmp_path / "my~20sphere.mtl").read_text()
    uv = np.array([line.split()[1:] for line in text.splitlines() if line[:3] == "vt "], float)
    corner = next(line for line in text.splitlines() if line[:2] == "f ").split()[1].split("/")
    mesh = read_mesh(output)
    assert check_mesh(mesh).watertight
    picture = np.asarray(Image.open(tmp_path / "my~20sphere_colours.png"), float)
    place = mesh.vertices[int(corner[0]) - 1]
    seen = _blend(picture, (uv[int(corner[1]) - 1] * (1.0, -1.0) + (0.0, 1.0))[None])
    assert np.abs(seen - paint(place / np.linalg.norm(place))).max() < 25.0


def test_points_without_colours_give_normals_alone(sphere: Path, tmp_path: Path) -> None:
    words = ("--attributes", "none", "--faces", str(FACES), "--texture", "256")
    run(sphere, tmp_path / "grey.glb", *words)
    glb = Glb(tmp_path / "grey.glb")
    assert not glb.colours.size
    assert np.median(errors({**glb.sample(np.full(3, 1 / 3)), "colours": np.zeros(3)})[1]) < 2.0


def test_the_same_texture_comes_from_any_number_of_threads(
    sphere: Path, textured: Path, tmp_path: Path
) -> None:
    words = ["--faces", str(FACES), "--texture", str(PIXELS), "--backend", "threads"]
    run(sphere, tmp_path / "again.glb", *words, "--workers", "2")
    assert (tmp_path / "again.glb").read_bytes() == textured.read_bytes()


@pytest.mark.parametrize(
    ("output", "words", "said"),
    [
        ("m.ply", ["--faces", "500"], "holds no texture"),
        ("m.glb", ["--tolerance", "0.1"], "give --faces up to 200000"),
        ("m.glb", ["--faces", "200001"], "give --faces up to 200000"),
        ("m.glb", ["--faces", "500", "--size", "1MB"], "exclude each other"),
        ("m.glb", ["--faces", "500", "--attributes", "normals"], "holds colours"),
    ],
)
def test_what_gives_no_texture_is_refused_at_once(
    sphere: Path, tmp_path: Path, output: str, words: list[str], said: str
) -> None:
    with pytest.raises(HpcError) as refused:
        run(sphere, tmp_path / output, "--texture", "512", *words)
    assert isinstance(refused.value, UsageError)
    assert said in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_a_missing_library_is_named(
    sphere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hpcapp.extras.find_spec", lambda name: None)
    with pytest.raises(MissingLibraryError, match="xatlas"):
        run(sphere, tmp_path / "m.glb", "--faces", "500", "--texture", "512")


def test_texels_finer_than_a_third_of_the_spacing_are_blended() -> None:
    """Of a surface of 1 unit a side, on half of the picture: 0.0014 wide, and 0.0007."""
    spacings = (None, 0.0082, 0.0084, 0.0165, 0.0167, 9.0)
    assert [choose_step(1 / 1024, 1024, spacing) for spacing in spacings] == [1, 1, 2, 2, 4, 4]
    assert choose_step(1 / 1023, 1023, 9.0) == 1


@pytest.mark.slow
def test_a_finer_picture_shows_what_the_points_tell(sphere: Path, tmp_path: Path) -> None:
    """Of points .0177 apart, 2,048 texels along a side tell as much as 1,024."""
    run(sphere, tmp_path / "fine.glb", "--faces", str(FACES), "--texture", "2048")
    glb = Glb(tmp_path / "fine.glb")
    assert glb.colours.shape == glb.normals.shape == (2048, 2048, 3)
    for weights in [(1 / 3, 1 / 3, 1 / 3), (0.02, 0.03, 0.95)]:
        colours, normals = errors(glb.sample(np.array(weights)))
        assert np.median(colours) < 4.0
        assert np.quantile(colours, 0.99) < 25.0
        assert np.median(normals) < 1.5
