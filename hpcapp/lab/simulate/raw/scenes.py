"""The scenes of raw scans, each drawn anew for a seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.lab.simulate.fields import unite
from hpcapp.lab.simulate.implicit import Bounds, ImplicitShape, diagonal_of
from hpcapp.lab.simulate.raw.canopy import Canopy, Crown
from hpcapp.lab.simulate.raw.parts import (
    Box,
    HeightField,
    ScenePart,
    join_meshes,
    make_boxes,
    make_houses,
    make_model,
    make_trunks,
)
from hpcapp.lab.simulate.shapes import find_shape
from hpccomponent.dataclass import dataclass

Walk = Callable[[FloatArray], tuple[FloatArray, FloatArray]]

_NODE = 0.5  # metres between two heights of the ground
_BORDER = 0.5  # metres of ground that go on beyond what is scanned
_EYE_LEVEL = 1.7  # metres
_TRUNK_RADIUS = 0.2  # metres
_CLEARING = 2.5  # metres between trunks, and from a stand to a trunk
HEAP, PIT = 100.0, 20.0
"""Cubic metres that lie on the yard in the scene ``heap``, and that have been dug out of it."""


@dataclass(frozen=True, slots=True, eq=False)
class RawScene:
    """What is scanned, and from where.

    Parameters
    ----------
    bounds : Bounds
        What is scanned lies between these corners.
    unit : float
        What stands for a metre, in length units: the diagonal of an object.
    border : float
        Width of the strip along its sides where the surface just ends, in length units.
    stands : ndarray of float64, shape (s, 3)
        Places of a tripod's head.
    walk : callable
        Maps times from 0 to 1, shape (n,), to the places of a camera in the hand and to what it
        looks at, each of shape (n, 3).
    """

    name: str
    parts: tuple[ScenePart, ...]
    bounds: Bounds
    unit: float = 1.0
    canopy: Canopy | None = None
    border: float = 0.0
    stands: FloatArray | None = None
    walk: Walk | None = None

    @property
    def surface(self) -> ImplicitShape:
        """Return all parts as one solid."""
        return ImplicitShape(self.name, 0, self.bounds, unite(*(part.field for part in self.parts)))

    @property
    def truth(self) -> Mesh:
        """Return the surface, with the class of each vertex."""
        mesh = join_meshes([part.mesh for part in self.parts])
        kinds = [np.full(len(part.mesh.vertices), part.kind, np.uint8) for part in self.parts]
        return replace(mesh, attributes={"classification": np.concatenate(kinds)})

    def classify(self, points: FloatArray) -> IntArray:
        """Return the class of the part that is nearest to each point of the surface."""
        values = np.stack([np.abs(part.field.value(points)) for part in self.parts])
        kinds: IntArray = np.array([part.kind for part in self.parts])[values.argmin(axis=0)]
        return kinds


def _make_terrain(rng: np.random.Generator, shape: str) -> RawScene:
    del shape
    ground = _make_hills(rng, extent=100.0, relief=4.0)
    return _outdoors("terrain", 100.0, (ground.as_part(),), _stand_on(ground, [(50.0, 50.0)]))


def _make_yard(rng: np.random.Generator, shape: str) -> RawScene:
    del rng, shape
    return _fence("yard", _lay_yard())


def _make_heap(rng: np.random.Generator, shape: str) -> RawScene:
    del rng, shape
    yard = _lay_yard()
    y, x = np.indices(yard.shape) * _NODE
    heap = np.maximum(5.0 - np.hypot(x - 24.0, y - 22.0), 0.0)  # a cone
    pit = np.maximum(9.0 - (x - 11.0) ** 2 - (y - 12.0) ** 2, 0.0)  # a bowl
    # a height of one at a node is a volume of the square of the step
    heap, pit = (size * part / (part.sum() * _NODE**2) for size, part in ((HEAP, heap), (PIT, pit)))
    return _fence("heap", yard + heap - pit)


def _lay_yard() -> FloatArray:
    """Return the heights of a yard 40 m wide, which are the same for every seed."""
    return _draw_hills(np.random.default_rng(0), extent=40.0, relief=1.0)


def _fence(name: str, heights: FloatArray) -> RawScene:
    ground = HeightField(heights, _NODE)
    stands = _stand_on(ground, [(6.0, 20.0), (34.0, 34.0), (30.0, 6.0)])
    return _outdoors(name, 40.0, (ground.as_part(),), stands)


def _make_forest(rng: np.random.Generator, shape: str) -> RawScene:
    del shape
    extent = 60.0
    ground = _make_hills(rng, extent, relief=2.5)
    stands = _stand_on(ground, [(15.0, 18.0), (42.0, 24.0), (27.0, 45.0)])
    # (n, 2): trees and, first, the stands, which keep their distance
    places = stands[:, :2]
    for place in rng.uniform(2.0, extent - 2.0, (600, 2)):
        if np.hypot(*(places - place).T).min() > _CLEARING:
            places = np.vstack([places, place])
    x, y = places[len(stands) :].T
    foot, height = ground.evaluate_height(x, y), rng.uniform(11.0, 20.0, len(x))
    radius, base = rng.uniform(1.6, 2.8, len(x)), foot + height * rng.uniform(0.3, 0.45, len(x))
    trees = np.column_stack([x, y, radius, base, foot + height])
    canopy = Canopy([Crown(*tree) for tree in trees.tolist()], extent)
    trunks = make_trunks(np.column_stack([x, y, foot - 0.5]), foot + 0.7 * height, _TRUNK_RADIUS)
    return _outdoors("forest", extent, (ground.as_part(), trunks), stands, canopy)


def _make_town(rng: np.random.Generator, shape: str) -> RawScene:
    del shape
    extent, lot = 80.0, 20.0
    ground = _make_hills(rng, extent, relief=1.0)
    corners, eaves, ridges = [], [], []
    for middle in lot * (np.mgrid[:4, :4].reshape(2, -1).T + 0.5):
        size = 0.5 * np.array([rng.uniform(8.0, 11.0), rng.uniform(6.0, 8.0)])
        turn = rng.normal(0.3, 0.1) + 0.5 * np.pi * rng.integers(2)
        spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        x, y = (middle + rng.uniform(-1.0, 1.0, 2) + _SQUARE * size @ spin.T).T
        corners.append(np.column_stack([x, y, ground.evaluate_height(x, y)]))
        eaves.append(rng.uniform(4.0, 7.0))
        ridges.append(eaves[-1] + rng.uniform(1.5, 4.0))
    houses, bare = make_houses(corners, eaves, ridges), ground.as_part()
    # nobody sees the ground within a house
    is_inside = houses.field.value(bare.mesh.vertices) < 0.0
    seen = Mesh(bare.mesh.vertices, bare.mesh.faces[~is_inside[bare.mesh.faces].all(axis=1)])
    stands = _stand_on(ground, [(20.0, 20.0), (60.0, 40.0), (40.0, 60.0)])
    return _outdoors("town", extent, (replace(bare, mesh=seen), houses), stands)


_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def _make_room(rng: np.random.Generator, shape: str) -> RawScene:
    del shape
    x, y = rng.uniform(-0.3, 0.3, 2)  # where the table and the chair stand
    # boxes reach into each other: two faces in one plane would leave a skin between them
    boxes: list[Box] = [
        ((-0.3, -0.3, -0.3), (6.3, 4.3, 3.0), True),
        ((0.0, 0.0, 0.0), (6.0, 4.0, 2.7), False),
        ((2.4, 3.9, 0.9), (4.2, 4.2, 2.1), False),  # window
        ((-0.1, 0.6, 0.0), (0.1, 1.5, 2.05), False),  # door
        ((5.4, -0.1, -0.1), (6.1, 1.8, 2.0), True),  # cupboard
        ((-0.1, 2.6, -0.1), (2.0, 4.1, 0.5), True),  # bed
        *_make_table((3.0 + x, 1.5 + y), (1.5, 0.8), 0.74),
        *_make_table((3.5 + x, 2.5 + y), (0.45, 0.45), 0.45),
        ((3.5 + x, 2.91 + y, 0.43), (3.95 + x, 2.95 + y, 0.95), True),  # back of the chair
    ]

    def walk(time: FloatArray) -> tuple[FloatArray, FloatArray]:
        turn = 2.0 * np.pi * time
        height = 1.45 + 0.15 * np.sin(3.0 * turn)
        eyes = np.column_stack([2.9 + 1.6 * np.cos(turn), 2.0 + 0.9 * np.sin(turn), height])
        tilt = 0.8 * np.sin(7.0 * turn)
        ahead = np.column_stack([np.cos(3.0 * turn), np.sin(3.0 * turn), tilt])
        return eyes, eyes + ahead

    stands = np.array([[1.8, 1.5, 1.5], [5.2, 3.2, 1.6]])
    bounds = np.array(boxes[0][0]), np.array(boxes[0][1])
    return RawScene("room", (make_boxes(boxes),), bounds, stands=stands, walk=walk)


def _make_object(rng: np.random.Generator, shape: str) -> RawScene:
    del rng
    model = find_shape(shape)
    low, high = model.bounds
    middle, diagonal = 0.5 * (low + high), diagonal_of(model)

    def walk(time: FloatArray) -> tuple[FloatArray, FloatArray]:
        turn, tilt = 6.0 * np.pi * time, 1.2 * np.sin(2.0 * np.pi * time)
        around = np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)
        eyes = middle + 1.1 * diagonal * np.column_stack(around)
        return eyes, np.broadcast_to(middle, eyes.shape)

    return RawScene("object", (make_model(model),), model.bounds, diagonal, walk=walk)


SCENES: Mapping[str, Callable[[np.random.Generator, str], RawScene]] = MappingProxyType(
    {
        "terrain": _make_terrain,
        "yard": _make_yard,
        "heap": _make_heap,
        "forest": _make_forest,
        "town": _make_town,
        "room": _make_room,
        "object": _make_object,
    }
)
"""What makes a scene, given the name of the model that an object is."""


def _make_hills(rng: np.random.Generator, extent: float, relief: float) -> HeightField:
    return HeightField(_draw_hills(rng, extent, relief), _NODE)


def _draw_hills(rng: np.random.Generator, extent: float, relief: float) -> FloatArray:
    """Return heights of ground of waves of 20 m to 80 m, and of a tenth of both."""
    y, x = np.mgrid[: int(extent / _NODE) + 1, : int(extent / _NODE) + 1] * _NODE
    heights = np.zeros(x.shape)
    for scale, height in ((20.0, relief), (2.0, 0.04 * relief)):
        length = scale * rng.uniform(1.0, 4.0, 16)
        angle, phase = rng.uniform(0.0, 2.0 * np.pi, (2, 16))
        for wave in range(16):
            along = x * np.cos(angle[wave]) + y * np.sin(angle[wave])
            turn = 2.0 * np.pi * along / length[wave] + phase[wave]
            heights += 0.25 * height * length[wave] / (4.0 * scale) * np.sin(turn)
    return heights


def _stand_on(ground: HeightField, places: list[tuple[float, float]]) -> FloatArray:
    x, y = np.array(places).T
    return np.column_stack([x, y, ground.evaluate_height(x, y) + _EYE_LEVEL])


def _make_table(corner: tuple[float, float], size: tuple[float, float], top: float) -> list[Box]:
    """Return a board on four legs."""
    (x, y), (a, b), thick, leg = corner, size, 0.04, 0.05
    feet = [(x + i * (a - leg), y + j * (b - leg)) for i in (0, 1) for j in (0, 1)]
    legs: list[Box] = [((u, v, -0.1), (u + leg, v + leg, top - 0.5 * thick), True) for u, v in feet]
    return [((x, y, top - thick), (x + a, y + b, top), True), *legs]


def _outdoors(
    name: str,
    extent: float,
    parts: tuple[ScenePart, ...],
    stands: FloatArray,
    canopy: Canopy | None = None,
) -> RawScene:
    """Return a scene whose first part is the ground."""
    heights = np.concatenate([part.mesh.vertices[:, 2] for part in parts])
    top = heights.max() if canopy is None else canopy.top
    low = np.array([_BORDER, _BORDER, parts[0].mesh.vertices[:, 2].min()])
    high = np.array([extent - _BORDER, extent - _BORDER, top])
    return RawScene(name, parts, (low, high), canopy=canopy, border=1.0, stands=stands)
