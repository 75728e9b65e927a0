from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.steps.diagnostics import (
    check_closing,
    check_closure,
    check_handles,
    check_resolution,
    check_sides,
    check_support,
)
from hpcapp.applications.surface.stitching.handle_groups import Mended
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.applications.surface.types.reading import Reading
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud


def surface_of(vertices: FloatArray) -> Surface:
    return Surface.of_mesh(Mesh(vertices, np.arange(3 * (len(vertices) // 3)).reshape(-1, 3)))


def test_a_good_scan_is_not_doubted(sphere: PointCloud) -> None:
    assert check_resolution(sphere, 2.0 / 64) == []
    assert (
        check_closure(*bound_points(sphere.positions), surface_of(sphere.positions), 2.0 / 64) == []
    )


def test_a_file_is_warned_of_where_its_normals_make_it_a_room() -> None:
    assert "face inwards" in check_sides(Reading("inside", 0.9))[0]
    assert not any(check_sides(Reading(kind)) for kind in ("outside", "above", "-x+y", "places"))


@pytest.mark.parametrize(("is_open", "asked", "kept"), [(True, "yes", "no"), (False, "no", "yes")])
def test_what_is_unsure_to_be_open_is_said_with_both_options(
    is_open: bool, asked: str, kept: str
) -> None:
    facts = {"open": is_open, "closure_certainty": 0.7}
    (warning,) = check_closing(facts)
    assert "70 % sure" in warning
    assert warning.index(f"close={asked!r} makes it") < warning.index(f"close={kept!r} keeps it")
    assert not check_closing({**facts, "closure_certainty": 0.95})
    assert not check_closing({"open": is_open})


def test_an_outlier_that_takes_up_the_grid_is_noticed(sphere: PointCloud) -> None:
    positions = np.vstack([sphere.positions, [[1e4, 0.0, 0.0]]])
    assert "outliers" in check_resolution(PointCloud(positions), 1e4 / 64)[0]


def test_a_mesh_far_outside_its_points_is_noticed(sphere: PointCloud) -> None:
    swollen = surface_of(1.5 * sphere.positions)
    assert (
        "outside the points' bounding box"
        in check_closure(*bound_points(sphere.positions), swollen, 2.0 / 64)[0]
    )


@pytest.mark.parametrize(("gap", "said"), [(0.0, "noise"), (0.5, "scan lines, some 0.5 apart")])
def test_a_handle_that_cannot_be_cut_is_noticed(gap: float, said: str) -> None:
    found = Mended(cut=3, left=1, place=np.array([101.5, 0.0, 2.0]), width=0.4)
    warnings = check_handles(found.facts(), gap)
    assert len(warnings) == 1
    assert warnings[0].startswith("1 handle no wider than 0.4, one at (101.5, 0, 2): ")
    assert said in warnings[0]


def test_a_mesh_without_handles_is_not_doubted() -> None:
    assert check_handles(Mended(cut=2).facts(), 0.0) == []
    assert check_handles({}, 0.0) == []


def test_a_mesh_closed_over_a_side_that_was_not_scanned_is_warned_of() -> None:
    def warn(share: float) -> list[str]:
        return check_support({"support": {"share": share, "farthest": 1.5, "reach": 0.1}})

    assert warn(0.82) == []
    (warning,) = warn(0.72)
    assert "28 % of the mesh is supported by no point, up to 1.5 from the nearest" in warning
    assert "close='no' leaves it open" in warning
    assert check_support({"open": True}) == []
