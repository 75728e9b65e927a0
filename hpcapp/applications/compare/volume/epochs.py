"""Two epochs of one place, as meshes or as points, and what changed between them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from hpcapp.applications.compare.truth import SHAPE, MeshTruth, check_usable
from hpcapp.applications.compare.volume.heights import Heights, drop_heights, fit_heights
from hpcapp.applications.compare.volume.lattice import Lattice
from hpcapp.applications.compare.volume.measure import Change, SolidChange
from hpcapp.applications.compare.volume.solids import measure_solids
from hpcapp.applications.compare.volume.terrain import FEWEST_CELLS, measure_terrain
from hpcapp.applications.surface.attributes.carrying import SUPPORT
from hpcapp.applications.surface.steps.report_page import GUESSED
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray, PointCloud
from hpcapp.io import find_mesh_crs, holds_faces, open_points, read_mesh, read_whole, take_finite
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.geocentric import refuse_geocentric
from hpcapp.pages.thin import thin_mesh
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError

log = logging.getLogger("hpcapp")

PER_CELL = 4.0
"""Points where they are sparse: as many as a plane needs, without its neighbours. Half or double
of it widens an uncertainty, and makes none wrong (`benchmarks/volumes.py`)."""
_SPARSE = 0.9  # share of the points that are denser
_NEAREST = 16  # points that tell a density
_TOLD = 200_000  # points whose density is told
_BORDER = 0.1
"""Spacings within which the border of points is known: two deviations of its place
(`benchmarks/volumes.py`)."""
_MESH_BORDER = 1.2
"""Spacings of vertices, of a mesh: they are half of those of its points, and it ends up to .6 of
those beyond them."""
_ACROSS = 500  # cells along the longer side of meshes, at least
MOST_CELLS = 4_000_000
"""Of one lattice: points take 400 bytes of memory for each."""
_MOST_FACES = 500_000  # of a closed mesh that is shown: its distances are exact, 10 µs each
FEW_LAYERS = 0.01
"""Share of the area with several heights: bare ground has none, a town 0.43, a forest 0.99
(`benchmarks/volumes.py`)."""


@dataclass(frozen=True, slots=True, eq=False)
class Epoch:
    """One of two scans of a place.

    Errors call it by its name; its heights are in the unit of x and y.
    """

    name: str
    surface: Mesh | PointCloud
    crs: Crs = UNKNOWN

    @property
    def positions(self) -> FloatArray:
        """The points, or the vertices of faces, shape (n, 3)."""
        if isinstance(self.surface, PointCloud):
            return self.surface.positions
        return self.surface.vertices[np.unique(self.surface.faces)]

    def turn(self, up: str, origin: FloatArray) -> Epoch:
        """Return the epoch in a frame with this origin, with z up.

        Raise InputError where coordinates are from the earth's centre (`refuse_geocentric`).
        """
        low, high = (corner + self.surface.origin for corner in bound_points(self.positions))
        refuse_geocentric(self.name, low, high, self.crs)
        turned = np.roll(self.surface.origin - origin, _find_turn(up))
        if isinstance(self.surface, PointCloud):
            places = np.roll(self.surface.positions, _find_turn(up), axis=1) + turned
            return replace(self, surface=PointCloud(places))
        places = np.roll(self.surface.vertices, _find_turn(up), axis=1) + turned
        return replace(self, surface=replace(self.surface, vertices=places, origin=np.zeros(3)))

    def choose_step(self) -> float:
        """Return the width of cells that its points or faces are dense enough for.

        Errors are those of `find_spacing`.
        """
        step = float(PER_CELL**0.5) * self.find_spacing()
        if isinstance(self.surface, PointCloud):
            return step
        return min(step, float(np.ptp(self.positions[:, :2], axis=0).max()) / _ACROSS)

    def find_border(self) -> float:
        """Return within what its border is known: a mesh ends about where its points do."""
        share = _BORDER if isinstance(self.surface, PointCloud) else _MESH_BORDER
        return share * self.find_spacing()

    def find_spacing(self) -> float:
        """Return the spacing of its points or vertices, seen from above, where they are sparse.

        Raise InputError where all of it is over one place.
        """
        places = self.positions[:, :2]
        every = -(-len(places) // _TOLD)
        told = np.unique(places[::every], axis=0)
        if len(told) == 1:
            raise InputError(f"{self.name}: all of it is over one place", "give one with an extent")
        nearest = min(_NEAREST, len(told) - 1)
        radius = float(np.quantile(KDTree(told).query(told, k=nearest + 1)[0][:, -1], _SPARSE))
        return radius * float(np.sqrt(np.pi / (nearest * every)))

    def read_heights(self, lattice: Lattice, spacing: float) -> Heights:
        """Return its heights; guesswork of a mesh, which no point supports, is none."""
        if isinstance(self.surface, PointCloud):
            return fit_heights(self.surface.positions, lattice, spacing)
        support = self.surface.attributes.get(SUPPORT)
        if support is None:
            return drop_heights(self.surface, lattice)
        is_known: BoolArray = support <= GUESSED
        corners = is_known[self.surface.faces]
        return drop_heights(self.surface, lattice, corners[:, 0] & corners[:, 1] & corners[:, 2])


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What changed, and how to show it; the unit of length is "" where it is not known.

    `show` returns the new surface in the frame of the input, and how far each vertex is in front of
    the old one, (v,): NaN where that is not there.
    """

    change: Change | SolidChange
    unit: str
    show: Callable[[], tuple[Mesh, FloatArray]]


def open_epoch(name: str) -> Epoch:
    """Read a mesh, or points.

    Raise InputError where the file cannot be read or is empty, and UsageError where it is a shape,
    or its suffix is unknown.
    """
    if name.startswith(SHAPE):
        raise UsageError(f"{name} is no scan", "give two meshes or two clouds of one place")
    path = Path(name)
    if holds_faces(path):
        mesh = read_mesh(path)
        check_usable(mesh, path)
        crs = find_mesh_crs(path)
        places = mesh.vertices * (1.0, 1.0, crs.height_scale)
        origin = mesh.origin * (1.0, 1.0, crs.height_scale)
        return Epoch(name, replace(mesh, vertices=places, origin=origin), crs)
    source = open_points(path)
    cloud = take_finite(read_whole(source.isotropic()), name)
    for finding in source.findings.lines():
        log.warning("%s: %s", name, finding)
    return Epoch(name, cloud, source.frame)


def measure_epochs(
    new: Epoch,
    old: Epoch,
    up: str = "z",
    step: float | None = None,
    registration: float | None = None,
) -> Measured:
    """Measure what changed between two epochs of one place.

    Parameters
    ----------
    step : float, optional
        Width of a cell of terrain; by default as wide as the sparser epoch needs.
    registration : float, optional
        What `find_registration` takes as vouched.

    Raises
    ------
    InputError
        They have hardly any ground in common, or one is closed and the other is not.
    UsageError
        Cells are too small, or their width is given for closed meshes.
    """
    origin, unit = new.surface.origin, new.crs.unit or old.crs.unit or ""
    new_solid, old_solid = _find_solid(new, origin), _find_solid(old, origin)
    if new_solid is not None and old_solid is not None:
        if step is not None:
            raise UsageError("closed meshes have no cells seen from above", "leave --cell out")
        change = measure_solids(new_solid, old_solid, registration)
        return Measured(change, unit, partial(_show_solid, new_solid, old_solid))
    if new_solid is not None or old_solid is not None:
        closed, other = (new, old) if new_solid is not None else (old, new)
        raise InputError(
            f"{closed.name} is a closed mesh and {other.name} is none",
            "compare two closed meshes, or two terrains: points can be meshed, and holes filled, "
            "by hpcapp reconstruct --close",
        )
    turned = new.turn(up, origin), old.turn(up, origin)
    rise, mesh, heights = _measure_heights(turned[0], turned[1], step, registration)
    return Measured(rise, unit, lambda: (_turn_back(mesh, up, origin), heights))


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
            "heights differ by more than a cell is wide on %.2g %% of the common area: crowns "
            "and walls are counted as ground unless they are left out",
            100.0 * change.layered / change.common,
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


def _find_turn(up: str) -> int:
    return 2 - "xyz".index(up)


def _turn_back(mesh: Mesh, up: str, origin: FloatArray) -> Mesh:
    places = np.roll(mesh.vertices, -_find_turn(up), axis=1)
    return Mesh(places, mesh.faces, origin, None, mesh.colours, mesh.attributes)
