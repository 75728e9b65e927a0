"""Two epochs of one place, as meshes or as points, and what changed between them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from hpcapp.applications.compare.truth import MeshTruth
from hpcapp.applications.compare.volume.measure import Change, SolidChange
from hpcapp.applications.compare.volume.solids import measure_solids
from hpcapp.applications.compare.volume.terrain import FEWEST_CELLS, measure_terrain
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.pages.thin import thin_mesh
from hpcapp.terrain.epoch import FEW_LAYERS, MOST_CELLS, PER_CELL, Epoch, find_turn
from hpcapp.terrain.lattice import Lattice
from hpcapp.wording import say_share
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError

log = logging.getLogger("hpcapp")

_MOST_FACES = 500_000  # of a closed mesh that is shown: its distances are exact, 10 µs each


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredChange:
    """What changed, and how to show it; the unit of length is "" where it is not known.

    `show` returns the new surface in the frame of the input, and how far each vertex is in front of
    the old one, (v,): NaN where that is not there.
    """

    change: Change | SolidChange
    unit: str
    show: Callable[[], tuple[Mesh, FloatArray]]


def measure_epochs(
    new: Epoch,
    old: Epoch,
    up: str = "z",
    step: float | None = None,
    registration: float | None = None,
) -> MeasuredChange:
    """Measure what changed between two epochs of one place.

    Cells of terrain are as wide as a step, by default as the sparser epoch needs; `registration` is
    what `find_registration` takes as vouched. Raise InputError where they have hardly any ground in
    common, or one is closed and the other is not, and UsageError where cells are too small, or
    their width is given for closed meshes.
    """
    origin, unit = new.surface.origin, new.crs.unit or old.crs.unit or ""
    new_solid, old_solid = _find_solid(new, origin), _find_solid(old, origin)
    if new_solid is not None and old_solid is not None:
        if step is not None:
            raise UsageError("closed meshes have no cells seen from above", "leave --cell out")
        change = measure_solids(new_solid, old_solid, registration)
        return MeasuredChange(change, unit, partial(_show_solid, new_solid, old_solid))
    if new_solid is not None or old_solid is not None:
        closed, other = (new, old) if new_solid is not None else (old, new)
        raise InputError(
            f"{closed.name} is a closed mesh and {other.name} is none",
            "compare two closed meshes, or two terrains: points can be meshed, and holes filled, "
            "by hpcapp reconstruct --close",
        )
    turned = new.turn(up, origin), old.turn(up, origin)
    rise, mesh, heights = _measure_heights(turned[0], turned[1], step, registration)
    return MeasuredChange(rise, unit, lambda: (_turn_back(mesh, up, origin), heights))


def _measure_heights(
    new: Epoch, old: Epoch, step: float | None, registration: float | None
) -> tuple[Change, Mesh, FloatArray]:
    """Return what changed between two terrains, and the new one as a mesh with its rise."""
    low, high = bound_points(np.concatenate([new.positions, old.positions]))
    least = float(np.sqrt(np.prod((high - low)[:2]) / MOST_CELLS))
    need = max(new.choose_step(), old.choose_step())
    width = step or max(need, least)
    if width < least:
        raise UsageError(
            f"cells {width:.3g} wide are more than {MOST_CELLS:,}", f"give {least:.2g} or more"
        )
    lattice = Lattice.over(low[:2], high[:2], width)
    spacing, border = need / float(PER_CELL**0.5), max(new.find_border(), old.find_border())
    heights = new.read_heights(lattice, spacing), old.read_heights(lattice, spacing)
    common = int(np.count_nonzero(np.isfinite(heights[0].values + heights[1].values)))
    if common < FEWEST_CELLS:
        raise InputError(
            f"{new.name} and {old.name} have {common} cells in common, {width:.3g} wide",
            f"give two scans of one place in one frame, or a --cell below {width:.2g}",
        )
    change = measure_terrain(*heights, border, lattice, registration)
    if change.layered > FEW_LAYERS * change.common:
        log.warning(
            "heights differ by more than a cell is wide on %s of the common area: crowns "
            "and walls are counted as ground unless they are left out",
            say_share(change.layered / change.common),
        )
    mesh, rows = _mesh_heights(heights[0].values, lattice)
    return change, mesh, (heights[0].values - heights[1].values).ravel()[rows]


def _mesh_heights(heights: FloatArray, lattice: Lattice) -> tuple[Mesh, IntArray]:
    """Return faces between the cells that have heights, and the cell of each vertex."""
    places = np.concatenate([lattice.middles, heights[..., None]], axis=2).reshape(-1, 3)
    number = np.arange(lattice.count).reshape(lattice.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.concatenate(
        [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))]
    )
    kept = faces[np.isfinite(places[faces, 2]).all(axis=1)]
    rows, corner = np.unique(kept, return_inverse=True)
    return Mesh(places[rows], corner.reshape(-1, 3)), rows


def _find_solid(epoch: Epoch, origin: FloatArray) -> Mesh | None:
    """Return a closed mesh in a frame with this origin, faces outwards; None of what is none."""
    mesh = epoch.surface
    if isinstance(mesh, PointCloud):
        return None
    mesh = replace(mesh, vertices=mesh.vertices + (mesh.origin - origin), origin=origin)
    topology = check_mesh(mesh)
    if not (topology.watertight and topology.oriented):
        return None
    return mesh if topology.outward else replace(mesh, faces=mesh.faces[:, ::-1])


def _show_solid(new: Mesh, old: Mesh) -> tuple[Mesh, FloatArray]:
    shown = thin_mesh(new, _MOST_FACES)
    truth = MeshTruth(old)
    sides = truth.find_sides(shown.vertices)
    distances = truth.distance(shown.vertices)
    return shown, distances if sides is None else sides * distances


def _turn_back(mesh: Mesh, up: str, origin: FloatArray) -> Mesh:
    places = np.roll(mesh.vertices, -find_turn(up), axis=1)
    return Mesh(places, mesh.faces, origin, None, mesh.colours, mesh.attributes)
