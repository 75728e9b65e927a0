"""Pages hold all that they show, and what is put into them is no markup."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.pages.page import Section, build_page, tabulate, write_page
from hpcapp.pages.scene import Field, Marker, Scene, fields_of, label_field
from hpccomponent.errors import OutputError

CORNERS = np.array([[0.0, 0, 0], [2.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
COLOURS = np.array([[255, 0, 0]] * 4, np.uint8)


class Reader(HTMLParser):
    """Gathers the elements of a page, and what they would load."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.loaded: list[str] = []
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(str(value))
            if name in ("src", "href"):
                self.loaded.append(str(value))

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    return reader


def scene_of(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="scene">(.*?)</script>', page)
    assert found
    scene: dict[str, Any] = json.loads(found[1])
    return scene


def make_scene(**more: Any) -> Scene:
    mesh = Mesh(CORNERS, FACES, colours=COLOURS, attributes={"intensity": np.arange(4.0)})
    return Scene(mesh, fields_of(mesh), PointCloud(CORNERS), **more)


def test_a_page_loads_nothing() -> None:
    page = build_page("t", "s", make_scene())
    reader = read(page)
    assert all(link.startswith(("#", "data:")) for link in reader.loaded)
    assert "url(" not in page
    assert "@import" not in page


def test_ids_are_unique() -> None:
    ids = read(build_page("t", "s", make_scene())).ids
    assert len(ids) == len(set(ids))


def test_what_is_put_in_is_text() -> None:
    evil = "</script><script>alert(1)</script><!--<script>\"'&"
    sections = [
        tabulate(evil, {evil: evil}, [evil, evil], [evil]),
        Section(evil, "warnings.html", {"marked": [evil], "others": [evil]}),
    ]
    page = build_page(evil, evil, make_scene(markers=[Marker(np.zeros(3), evil)]), sections)
    plain = build_page("t", "s", make_scene(markers=[Marker(np.zeros(3), "m")]))
    assert read(page).tags.count("script") == read(plain).tags.count("script")
    assert read(page).texts.count(evil) == 12
    assert scene_of(page)["markers"][0]["text"] == evil
    assert "<!--" not in page


def test_the_colours_of_a_mesh_are_shown_first() -> None:
    fields = scene_of(build_page("t", "s", make_scene()))["fields"]
    assert [one["name"] for one in fields] == ["colours", "plain", "normals", "attribute-intensity"]


def test_another_colouring_can_be_first() -> None:
    scene = make_scene(colouring="attribute-intensity")
    assert scene_of(build_page("t", "s", scene))["fields"][0]["name"] == "attribute-intensity"


def test_a_scale_has_the_numbers_of_its_ends_and_tells_what_lacks() -> None:
    mesh = Mesh(CORNERS, FACES)
    field = Field("f", "F", np.array([np.nan, 1.0, 2.0, 5.0]), "m", 0.0, 4.0)
    [found] = scene_of(build_page("t", "s", Scene(mesh, [field])))["fields"][2:]
    assert (found["low"], found["high"], found["unit"], found["lacks"]) == (0.0, 4.0, "m", True)


def test_labels_are_named() -> None:
    field = label_field("tile", "Tile", np.array([0, 2, 2, 1]), "tile")
    [found] = scene_of(build_page("t", "s", Scene(Mesh(CORNERS, FACES), [field])))["fields"][2:]
    assert found["labels"] == ["tile 0", "tile 1", "tile 2"]


def test_controls_are_those_of_what_is_there() -> None:
    mesh_only = read(build_page("t", "s", Scene(Mesh(CORNERS, FACES)))).ids
    assert "wireframe" in mesh_only
    assert "show-points" not in mesh_only
    assert "show-markers" not in mesh_only
    points_only = read(build_page("t", "s", Scene(None, points=PointCloud(CORNERS)))).ids
    assert "show-points" in points_only
    assert "colouring" in points_only
    assert "wireframe" not in points_only


def test_places_that_are_not_finite_do_no_harm() -> None:
    broken = CORNERS.copy()
    broken[3] = np.nan
    page = build_page("t", "s", Scene(Mesh(broken, FACES), points=PointCloud(broken)))
    scene = scene_of(page)
    assert scene["points"]["shown"] == 3
    assert np.isfinite(scene["mesh"]["low"]).all()


def test_the_same_scene_is_the_same_page() -> None:
    assert build_page("t", "s", make_scene()) == build_page("t", "s", make_scene())


def test_the_licence_of_three_is_in_it() -> None:
    page = build_page("t", "s", make_scene())
    assert "three.js authors" in page
    assert "Permission is hereby granted" in page


def test_a_page_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="create the folder"):
        write_page(tmp_path / "no" / "a.html", "x")


def test_both_sides_of_zero_have_a_scale_with_zero_in_its_middle() -> None:
    field = Field("f", "F", np.array([-3.0, 1.0, 2.0, 0.0]), "m", high=2.0, is_signed=True)
    [found] = scene_of(build_page("t", "s", Scene(Mesh(CORNERS, FACES), [field])))["fields"][2:]
    assert (found["low"], found["high"], found["from"], found["to"]) == (-2.0, 2.0, -3.0, 2.0)
    assert found["signed"] is True
