"""One scan of a place, as a mesh or as points, and the heights of it."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpcapp.geometry.support import GUESSED, SUPPORT
from hpcapp.io import find_mesh_crs, holds_faces, open_points, read_mesh, read_whole, take_finite
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.geocentric import refuse_geocentric
from hpcapp.io.usable_mesh import check_usable
from hpcapp.named_files import SHAPE
from hpcapp.terrain.cover import cover_cells
from hpcapp.terrain.heights import Heights, drop_heights, fit_heights
from hpcapp.terrain.lattice import Lattice
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
        turned = np.roll(self.surface.origin - origin, find_turn(up))
        if isinstance(self.surface, PointCloud):
            places = np.roll(self.surface.positions, find_turn(up), axis=1) + turned
            return replace(self, surface=PointCloud(places))
        places = np.roll(self.surface.vertices, find_turn(up), axis=1) + turned
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
            cover = cover_cells(self.surface.positions, spacing, lattice)
            return fit_heights(self.surface.positions, lattice, cover)
        support = self.surface.attributes.get(SUPPORT)
        if support is None:
            return drop_heights(self.surface, lattice)
        is_known: BoolArray = support <= GUESSED
        corners = is_known[self.surface.faces]
        return drop_heights(self.surface, lattice, corners[:, 0] & corners[:, 1] & corners[:, 2])


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


def find_turn(up: str) -> int:
    """Return by how many places axes are rolled for the one that is up to be the last."""
    return 2 - "xyz".index(up)
