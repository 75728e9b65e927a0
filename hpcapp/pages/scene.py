"""What a page draws: a mesh, numbers on its vertices, points beside it, and marked places."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.pages.arrays import Packable, PackedArray, pack_array, quantise
from hpcapp.pages.cutting import Cutting, pack_cutting
from hpccomponent.dataclass import dataclass

MOST_POINTS = 200_000
"""Of a cloud, so many are shown beside a mesh, evenly picked."""
_TOP = 0.95  # share of the vertices that a scale of colours covers: a few must not make all dark
_LEVELS = 65534  # the number 65535 means: no number

Pack = Callable[[Packable], str]  # puts an array on the page, and returns its name


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Numbers by which the vertices of a mesh, or points alone, can be coloured.

    Parameters
    ----------
    name, label : str
        In the page's program, and for people.
    values : ndarray, shape (v,)
        A number a vertex or a point, NaN where there is none; of labels, their indices in `labels`.
    unit : str
        Behind numbers.
    low, high : float, optional
        Ends of the scale; by default those of all but the largest twentieth.
    labels : sequence of str, optional
        What whole numbers stand for.
    is_signed : bool
        Whether both sides of zero are to be told apart: the scale has zero in its middle.
    sides : tuple of str
        What is below zero, and what is above.
    """

    name: str
    label: str
    values: NDArray[np.generic]
    unit: str = ""
    low: float | None = None
    high: float | None = None
    labels: Sequence[str] | None = None
    is_signed: bool = False
    sides: tuple[str, str] = ("inside", "outside")


@dataclass(frozen=True, slots=True)
class Tint:
    """What of a mesh is guesswork, and is tinted: where a field's number is beyond a limit.

    The text stands in the legend.
    """

    field: str
    beyond: float
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Marker:
    """A place (3,) in the frame of the scene, and what is to be said of it, in one line."""

    place: FloatArray
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All that a page draws, in one frame.

    Parameters
    ----------
    mesh : Mesh or None
        Its colours can be shown.
    fields : sequence of Field
        Of its vertices; of the points, where there is no mesh.
    points : PointCloud or None
        At most some `MOST_POINTS` of them are drawn.
    up : str
        The axis of `axis_names.AXES` that points up at first.
    colouring : str, optional
        The field that is shown at first; by default the colours, where there are some.
    unit : str
        Of length; nothing where it is not known.
    origin : ndarray of float64, shape (3,), or None
        What makes places of the scene coordinates of its file; None where it has none.
    height_scale : float
        How long a unit of z is, in units of x and y.
    cutting : Cutting or None
        How the file is cut, in the coordinates that `origin` gives.
    """

    mesh: Mesh | None
    fields: Sequence[Field] = ()
    points: PointCloud | None = None
    markers: Sequence[Marker] = ()
    up: str = "z"
    colouring: str | None = None
    unit: str = ""
    tint: Tint | None = None
    origin: FloatArray | None = None
    height_scale: float = 1.0
    cutting: Cutting | None = None


def fields_of(shown: Mesh | PointCloud) -> list[Field]:
    """Return the attributes of a mesh or of points as fields."""
    return [Field(f"attribute-{name}", name, shown.attributes[name]) for name in shown.attributes]


def label_field(name: str, label: str, numbers: NDArray[np.integer], words: str) -> Field:
    """Return whole numbers from 0, (v,), as a field of labels, behind words in the legend."""
    labels = [f"{words} {number}" for number in range(int(numbers.max(initial=0)) + 1)]
    return Field(name, label, numbers, labels=labels)


def pack_scene(scene: Scene) -> tuple[dict[str, object], list[PackedArray]]:
    """Return a scene as a page holds it: JSON values, which name the arrays, and these.

    Of its fields, the first is shown first.
    """
    arrays: list[PackedArray] = []

    def pack(values: Packable) -> str:
        arrays.append(pack_array(f"array-{len(arrays)}", values))
        return arrays[-1].name

    mesh = None if scene.mesh is None else _pack_mesh(scene.mesh, pack)
    fields = [] if scene.mesh is None else _pack_fields(scene, scene.mesh, pack)
    points = None
    if scene.points is not None and len(rows := _pick_points(scene.points)):
        sample = scene.points.take(rows)
        if scene.mesh is None:
            own = [replace(field, values=field.values[rows]) for field in scene.fields]
            fields = _pack_fields(replace(scene, fields=own), sample, pack)
        points = _pack_points(sample, pack, is_alone=scene.mesh is None)
    described: dict[str, object] = {
        "mesh": mesh,
        "fields": fields,
        "points": points,
        "markers": [{"place": mark.place.tolist(), "text": mark.text} for mark in scene.markers],
        "up": scene.up,
        "unit": scene.unit,
        "tint": None if scene.tint is None else asdict(scene.tint),
        "origin": None if scene.origin is None else scene.origin.tolist(),
        "heightScale": scene.height_scale,
        "cutting": None if scene.cutting is None else pack_cutting(scene.cutting, pack),
    }
    return described, arrays


def _pack_mesh(mesh: Mesh, pack: Pack) -> dict[str, object]:
    finite = mesh.vertices[np.isfinite(mesh.vertices).all(axis=1)]
    low, high = bound_points(finite) if len(finite) else np.zeros((2, 3))
    vertices = np.nan_to_num(mesh.vertices, nan=0.0)
    return {
        "low": low.tolist(),
        "step": (float((high - low).max()) or 1.0) / 65535,
        "positions": pack(quantise(vertices, low, high)),
        "indices": pack(mesh.faces.astype(np.uint32).reshape(-1)),
    }


def _pick_points(cloud: PointCloud) -> IntArray:
    """Return the rows of the finite points that are shown."""
    finite = np.flatnonzero(np.isfinite(cloud.positions).all(axis=1))
    return finite[:: max(1, -(-len(finite) // MOST_POINTS))]


def _pack_points(shown: PointCloud, pack: Pack, *, is_alone: bool) -> dict[str, object]:
    """Pack points; the fields hold the colours of points alone."""
    low, high = bound_points(shown.positions)
    colours = None if is_alone else shown.colours
    return {
        "low": low.tolist(),
        "step": (float((high - low).max()) or 1.0) / 65535,
        "positions": pack(quantise(shown.positions, low, high)),
        "colours": None if colours is None else pack(colours.astype(np.uint8)),
        "shown": len(shown),
    }


def _pack_fields(scene: Scene, shown: Mesh | PointCloud, pack: Pack) -> list[Mapping[str, object]]:
    """Pack what a mesh or points can be coloured by, what is shown first in front."""
    packed: list[Mapping[str, object]] = []
    if shown.colours is not None:
        colours = pack(shown.colours.astype(np.uint8))
        packed.append({"name": "colours", "label": "Colours", "kind": "rgb", "array": colours})
    packed.append({"name": "plain", "label": "One colour", "kind": "plain"})
    if isinstance(shown, Mesh):  # the page has them from the faces
        packed.append({"name": "normals", "label": "Normals", "kind": "normals"})
    elif shown.normals is not None:
        turned = np.rint(127.5 * (1.0 + np.nan_to_num(shown.normals))).astype(np.uint8)
        packed.append(
            {"name": "normals", "label": "Normals", "kind": "normals", "array": pack(turned)}
        )
    packed += [_pack_field(field, pack) for field in scene.fields]
    packed.sort(key=lambda field: field["name"] != scene.colouring)  # stable
    return packed


def _pack_field(field: Field, pack: Pack) -> Mapping[str, object]:
    packed: dict[str, object] = {"name": field.name, "label": field.label}
    if field.labels is not None:
        most = max(len(field.labels) - 1, 0)
        name = pack(field.values.astype(np.uint8) if most < 256 else field.values.astype(np.uint16))
        return packed | {"kind": "label", "labels": list(field.labels), "array": name}
    values = field.values.astype(np.float64)
    is_known = np.isfinite(values)
    low, high = _find_ends(field, values[is_known])
    start = min(low, float(values.min(initial=low, where=is_known)))
    end = max(high, float(values.max(initial=high, where=is_known)))
    share = (values - start) / ((end - start) or 1.0)
    levels = np.rint(_LEVELS * np.where(is_known, share, 0.0))
    return packed | {
        "kind": "scale",
        "low": low,
        "high": high,
        "from": start,
        "to": end,
        "signed": field.is_signed,
        "sides": field.sides,
        "unit": field.unit,
        "lacks": not bool(is_known.all()),
        "array": pack(np.where(is_known, levels, _LEVELS + 1).astype(np.uint16)),
    }


def _find_ends(field: Field, known: FloatArray) -> tuple[float, float]:
    """Return the two ends of a field's scale as it is shown at first."""
    if not len(known):
        return field.low or 0.0, field.high or 1.0
    if field.is_signed:
        high = float(np.quantile(np.abs(known), _TOP)) if field.high is None else field.high
        return -high, high
    low = float(known.min()) if field.low is None else field.low
    high = float(np.quantile(known, _TOP)) if field.high is None else field.high
    return low, high
