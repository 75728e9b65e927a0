"""The part of a scan that a user asks for: all heights above and below some polygons."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hpcapp.extras import load_library
from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.geometry.regions.clipping import CutPiece
from hpcapp.geometry.regions.region import Region, say_place
from hpcapp.geometry.regions.splitting import Walls
from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Prism:
    """What lies above and below polygons of shapely.

    They are valid, with holes or without, in the coordinates of the points.
    """

    polygons: Any

    @classmethod
    def of_text(cls, text: str) -> Prism:
        """Return the prism of polygons in WKT."""
        return cls(load_shapely().from_wkt(text))

    @property
    def low(self) -> FloatArray:
        """The least coordinates, shape (3,)."""
        return np.array([*self.polygons.bounds[:2], -np.inf])

    @property
    def high(self) -> FloatArray:
        """The greatest, likewise."""
        return np.array([*self.polygons.bounds[2:], np.inf])

    @property
    def longest(self) -> float:
        """The side of a square of the same area: a long strip asks for no wide margin."""
        return float(np.sqrt(self.polygons.area))

    @property
    def segments(self) -> FloatArray:
        """The sides of the polygons, from end to end: shape (s, 2, 2)."""
        shapely = load_shapely()
        rings = shapely.get_rings(shapely.get_parts(self.polygons))
        corners = [shapely.get_coordinates(ring) for ring in rings]
        return np.concatenate([np.stack([one[:-1], one[1:]], axis=1) for one in corners])

    def find(self, positions: FloatArray) -> BoolArray:
        """Tell which points of shape (n, 3) lie in it, its border included; NaN never does."""
        shapely = load_shapely()
        shapely.prepare(self.polygons)
        low, high = self.low, self.high
        x, y = positions[:, 0], positions[:, 1]
        inside: BoolArray = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
        inside &= np.isfinite(positions[:, 2])
        inside[inside] = shapely.intersects_xy(self.polygons, x[inside], y[inside])
        return inside

    def meets(self, lows: FloatArray, highs: FloatArray) -> BoolArray:
        """Tell which boxes, by corners of shape (n, 3), have a part in it."""
        shapely = load_shapely()
        boxes = shapely.box(lows[:, 0], lows[:, 1], highs[:, 0], highs[:, 1])
        meets: BoolArray = shapely.intersects(self.polygons, boxes)
        return meets

    def cut(self, piece: CutPiece) -> CutPiece:
        """Return what of a mesh, in its frame, lies in it."""
        split = Walls(self.segments, load_shapely()).split(piece)
        middles = split.vertices[split.faces].mean(axis=1)
        return replace(split, faces=split.faces[self.find(middles)])

    @property
    def on_the_wire(self) -> Region | None:
        """What workers are told of it: nothing, as they may lack the library."""
        return None

    def widen(self, margin: float) -> Prism:
        """Return what lies within a margin of it."""
        return self if margin == 0.0 else replace(self, polygons=self.polygons.buffer(margin))

    def localise(self, origin: FloatArray) -> Prism:
        """Return it in a local frame."""
        shapely = load_shapely()
        return Prism(shapely.transform(self.polygons, lambda places: places - origin[:2]))

    def __str__(self) -> str:
        return f"the polygon from {say_place(self.low[:2])} to {say_place(self.high[:2])}"


def load_shapely() -> Any:
    """Return the library of polygons; MissingLibraryError where it is not installed."""
    return load_library("shapely", "polygons need the package shapely", "gis")
