from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hpcapp.applications.surface.attributes.choice import AttributeChoice, parse_attributes
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpccomponent.errors import UsageError

CLOUD = PointCloud(
    np.zeros((2, 3)),
    np.ones((2, 3)),
    np.zeros((2, 3), np.uint8),
    {"intensity": np.zeros(2), "row": np.zeros(2), "scan": np.zeros(2), "label": np.zeros(2)},
)


@pytest.mark.parametrize(
    ("text", "has_colours", "names"),
    [
        ("auto", True, ["intensity", "label"]),
        ("none", False, []),
        ("normals", False, []),
        ("colours", True, []),
        ("colors,label", True, ["label"]),
        ("rgb", True, []),
        ("auto,row", True, ["intensity", "row", "label"]),
        (" label , intensity ", False, ["intensity", "label"]),
    ],
)
def test_columns_are_chosen_in_the_order_of_the_points(
    text: str, has_colours: bool, names: list[str]
) -> None:
    chosen = parse_attributes(text).select(CLOUD, "scan.ply")
    assert (chosen.colours is not None) == has_colours
    assert list(chosen.attributes) == names
    assert chosen.normals is not None


def test_what_is_made_for_the_vertices_is_asked_for_by_name() -> None:
    assert parse_attributes("auto") == AttributeChoice()
    assert parse_attributes("auto,support,normals") == AttributeChoice(True, (), True, True)
    assert parse_attributes("confidence") == AttributeChoice(False, has_confidence=True)


def test_a_column_called_confidence_is_taken_from_the_points() -> None:
    own = PointCloud(np.zeros((2, 3)), attributes={"confidence": np.ones(2), "x_scale": np.ones(2)})
    assert list(parse_attributes("confidence").select(own, "scan.ply").attributes) == ["confidence"]
    assert list(parse_attributes("auto").select(own, "scan.ply").attributes) == [*own.attributes]
    assert parse_attributes("confidence").select(CLOUD, "scan.ply").attributes == {}


def test_an_unknown_column_is_refused_with_those_there_are() -> None:
    with pytest.raises(UsageError) as refused:
        parse_attributes("auto,reflectance").select(CLOUD, "scan.ply")
    assert str(refused.value) == (
        "attributes='reflectance': there is no such column; scan.ply has colours, "
        "intensity, row, scan, label; normals and support can always be had"
    )
    with pytest.raises(UsageError, match=r"scan.ply has no other columns"):
        parse_attributes("colours").select(PointCloud(np.zeros((2, 3))), "scan.ply")


@pytest.mark.parametrize("text", ["", "a,,b", "auto,", "none,auto"])
def test_what_makes_no_sense_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="attributes="):
        parse_attributes(text)


@pytest.mark.parametrize(
    ("text", "has_normals", "has_colours", "names"),
    [
        ("auto", True, True, ["intensity", "scan", "support"]),
        ("none", False, False, []),
        ("normals,support", True, False, ["support"]),
        ("colors,scan", False, True, ["scan"]),
    ],
)
def test_of_a_mesh_all_that_is_there_can_be_named(
    text: str, has_normals: bool, has_colours: bool, names: list[str]
) -> None:
    columns = {name: np.zeros(3) for name in ("intensity", "scan", "support")}
    mesh = Mesh(np.eye(3), np.arange(3)[None], np.zeros(3), np.eye(3), np.zeros((3, 3), np.uint8))
    chosen = parse_attributes(text).select_of_mesh(replace(mesh, attributes=columns), "mesh.ply")
    assert (chosen.normals is not None) == has_normals
    assert (chosen.colours is not None) == has_colours
    assert list(chosen.attributes) == names
    with pytest.raises(UsageError, match="support': there is no such column"):
        parse_attributes("support").select_of_mesh(mesh, "mesh.ply")
