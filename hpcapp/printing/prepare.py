"""A mesh made a print: closed, in one piece, manifold, on a flat base, in millimetres; in words.

::

    mesh ── close ── which way up ── how large ── solid ── cut where it stands ── checked, said
"""

from __future__ import annotations

import logging
from dataclasses import replace
from math import floor, log10

import numpy as np

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.axes import rotate, turn_up
from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.io.crs import Crs
from hpcapp.io.meshes.mesh_stream import as_stream, find_vertices, make_mesh
from hpcapp.io.placement import choose_up
from hpcapp.mending.loops import SHEET
from hpcapp.printing.closing import Closed, close_mesh
from hpcapp.printing.request import Printing
from hpcapp.printing.solid import Body, back_relief, stand, thicken
from hpcapp.wording import say_count, say_number, say_share
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError, UsageError

log = logging.getLogger("hpcapp")

PRINTED = Crs(None, "mm")
"""What coordinates of a print mean."""

_BED = 250.0
"""Millimetres along a side, of the printers that most people have: 210 to 256, and 250 high."""
_UNKNOWN = 100.0  # millimetres: the longest side of what has no unit
_NOZZLE = 0.4  # millimetres: its usual width, below which nothing is laid down
_PARALLEL = 1e-9  # sine: what points along y has no side by it
_FEW = 0.04
"""Share of a surface that may be thinner, as edges are: .011 of a cliff with overhangs on its base,
.23 of a facade and the ground before it, to which a base below leaves no thickness."""


@dataclass(frozen=True, slots=True)
class Facts:
    """What a print is.

    Parameters
    ----------
    kind : str
        ``solid``, ``relief`` (a sheet on a flat base) or ``shell`` (a sheet with a wall).
    scale : float or None
        Of the print to what it is of; None where no unit is known.
    sides : tuple of float
        Millimetres along x, y and z.
    volume : float
        Cubic centimetres.
    base : float
        Square centimetres that it stands on.
    pieces, closed_holes : int
    thin : float
        Share of the surface, 0 to 1, with less than a nozzle behind it.
    warnings : tuple of str
    """

    kind: str
    scale: float | None
    sides: tuple[float, float, float]
    volume: float
    base: float
    pieces: int
    closed_holes: int
    thin: float
    warnings: tuple[str, ...]

    def describe(self) -> str:
        """Say it in a line."""
        x, y, z = (f"{side:.1f}" for side in self.sides)
        scale = "" if self.scale is None else f", scale {_say_scale(self.scale)}"
        volume, pieces = f"{say_number(self.volume)} cm3", say_count(self.pieces, "piece")
        return f"{x} x {y} mm, {z} mm tall{scale}, {volume}, closed, manifold, {pieces}"


def make_print(
    mesh: Mesh, crs: Crs, asked: Printing, up: str | None = None, pieces: int = 1
) -> tuple[Mesh, Facts]:
    """Return a mesh as it is to be printed, in millimetres from zero with z up, and what it is.

    Its vertices have the colours of the nearest ones of the mesh. Raise InputError where no solid
    can be made of it, and UsageError as of `Printing.find_unit`, or where it is lower than a wall.
    """
    mesh = replace(mesh, normals=None, attributes={})
    unit = asked.find_unit(crs.unit)
    axis = choose_up(replace(as_stream(mesh), crs=crs), up)
    closed = close_mesh(mesh, pieces)
    stances = (
        _stand(kind, places, closed.mesh.faces, unit, asked, pieces)
        for kind, places in _list_stances(_turn(closed.mesh, crs, axis), closed, up is not None)
    )
    best = next(stances)
    while best.body.thin > _FEW and (other := next(stances, None)) is not None:
        best = min(best, other, key=lambda stance: stance.body.thin)
    _say_steps(best, asked, closed.holes, pieces)
    return _carry(closed.mesh, best), _describe(best, unit, closed, pieces)


@dataclass(frozen=True, slots=True, eq=False)
class _Stance:
    """A way in which a mesh may be printed.

    `places` (v, 3) are the vertices of the mesh beside the body, and `factor` the millimetres that
    a unit of it becomes.
    """

    kind: str
    body: Body
    places: FloatArray
    factor: float


def _turn(mesh: Mesh, crs: Crs, axis: str) -> FloatArray:
    """Return the vertices of a mesh with z up, and heights as long as the other coordinates."""
    return rotate(mesh.vertices * [1.0, 1.0, crs.height_scale], turn_up(axis))


def _stand(
    kind: str,
    upright: FloatArray,
    faces: IntArray,
    unit: float | None,
    asked: Printing,
    pieces: int,
) -> _Stance:
    """Return vertices (v, 3) with z up, and their faces, as a solid of the size that is asked."""
    extra = 0.0 if kind == "solid" else asked.wall
    factor = _choose_factor(np.ptp(upright, axis=0), extra, unit, asked)
    places = upright * factor
    below = float(places[:, 2].min()) - asked.wall
    if kind == "relief":
        layer = (below, below)
        body = stand(*back_relief(places, faces, asked.wall), pieces, _NOZZLE, layer)
    elif kind == "shell":
        layer = (below, below + 0.5 * asked.wall)  # behind a rough floor it is rougher
        body = stand(*thicken(places, faces, asked.wall), pieces, _NOZZLE, layer)
    else:
        body = stand(places, faces, pieces, _NOZZLE)
    if asked.height is None:
        return _Stance(kind, body, places, factor)
    last = asked.height / float(np.ptp(body.vertices[:, 2]))  # what was cut off is missing
    return _Stance(kind, _resize(body, last), places * last, factor * last)


def _list_stances(
    places: FloatArray, closed: Closed, is_up_asked: bool
) -> list[tuple[str, FloatArray]]:
    """Return what may become of a surface with z up, and its vertices as they stand then.

    A sheet that faces up is backed below; another one lies on its back, with the side up from which
    it was seen. Where that leaves thin walls, which is measured, or neither can be, it gets a wall.
    """
    if not closed.is_open:
        return [("solid", places)]
    across = cross_edges(places[closed.mesh.faces])
    mean = across.sum(axis=0) / np.linalg.norm(across, axis=1).sum()
    shell = ("shell", places)
    if mean[2] > SHEET:
        return [("relief", places), shell]
    length = float(np.linalg.norm(mean))
    if length <= SHEET or is_up_asked:
        return [shell]
    normal = mean / length
    side = np.cross([0.0, 1.0, 0.0], normal)
    if np.linalg.norm(side) < _PARALLEL:
        side = np.array([1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(normal, side), normal])
    return [("relief", rotate(places, axes)), shell]


def _choose_factor(sides: FloatArray, extra: float, unit: float | None, asked: Printing) -> float:
    """Return the millimetres of a print that a unit of the mesh becomes.

    Sides (3,) are its own; what is added to its height is in millimetres.
    """
    if asked.height is not None:
        if asked.height <= extra:
            raise UsageError(
                f"of {asked.height:g} mm nothing is left above walls of {extra:g} mm",
                f"give a larger {name_option('height')}, or a smaller {name_option('wall')}",
            )
        return (asked.height - extra) / max(float(sides[2]), 1e-300)
    if unit is None:
        return _UNKNOWN / float(sides.max())
    if asked.scale is not None:
        return asked.scale * unit
    return min(1.0, _round_down((_BED - extra) / (unit * float(sides.max())))) * unit


def _round_down(scale: float) -> float:
    """Return the next scale below whose other side is 1, 2 or 5 times a power of ten.

    Examples
    --------
    >>> 1 / _round_down(1 / 46), 1 / _round_down(1 / 130)
    (50.0, 200.0)
    """
    power = 10.0 ** floor(log10(1.0 / scale))
    return 1.0 / next(step * power for step in (1, 2, 5, 10) if step * power * scale >= 1 - 1e-9)


def _say_scale(scale: float) -> str:
    """Say a scale, as of a map.

    Examples
    --------
    >>> _say_scale(0.02), _say_scale(2.0), _say_scale(1 / 38.7)
    ('1:50', '2:1', '1:38.7')
    """
    return f"{scale:.4g}:1" if scale > 1.0 else f"1:{1.0 / scale:.4g}"


def _resize(body: Body, factor: float) -> Body:
    return replace(
        body,
        vertices=body.vertices * factor,
        lost=body.lost * factor,
        base=body.base * factor**2,
        volume=body.volume * factor**3,
    )


def _say_steps(stance: _Stance, asked: Printing, holes: int, pieces: int) -> None:
    body = stance.body
    if holes:
        log.info("closed %s", say_count(holes, "hole"))
    if body.pieces > pieces:
        log.info("dropped %s that the cut has left", say_count(body.pieces - pieces, "piece"))
    if stance.kind == "relief":
        log.info("a sheet: backed by a flat base, %g mm below its lowest point", asked.wall)
        return
    if stance.kind == "shell":
        log.info("an open surface: a wall of %g mm is put behind it", asked.wall)
    cut = f": the lowest {body.lost:.1f} mm are cut off" if body.lost >= 0.05 else ""
    log.info("it stands on %s cm2%s", say_number(body.base / 100.0), cut)


def _describe(stance: _Stance, unit: float | None, closed: Closed, pieces: int) -> Facts:
    """Return the facts, and warn of what a printer cannot do."""
    body, scale = stance.body, None if unit is None else stance.factor / unit
    sides = np.ptp(body.vertices, axis=0)
    warnings = []
    if sides.max() > _BED + 1e-6:
        fit = _BED / float(sides.max())
        better = f"{100.0 * fit:.0f} % of the size"
        if scale is not None:
            better = name_option("scale", _say_scale(_round_down(scale * fit)))
        warnings.append(
            f"the print is larger than {_BED:.0f} mm, as most printers are: {better} fits"
        )
    if body.thin > _FEW:
        warnings.append(
            f"{say_share(body.thin)} of the surface is thinner than {_NOZZLE:g} mm, a usual "
            "nozzle: it may be missing in the print"
        )
    if closed.lids:
        warnings.append(
            f"{say_count(closed.lids, 'large hole')} got a lid of the least area, by guesswork: "
            "reconstruct closes it by points"
        )
    if closed.is_inward and stance.kind == "solid":
        warnings.append(
            "it is closed and was seen from inside, of which a print shows nothing: "
            f"{name_option('box')} cuts it open"
        )
    if not body.stands:
        warnings.append("the centre of its mass is not above its base: it tips over")
    for one in warnings:
        log.warning("warning: %s", one)
    x, y, z = sides.tolist()
    volume, base = body.volume / 1000.0, body.base / 100.0
    return Facts(
        stance.kind, scale, (x, y, z), volume, base, min(pieces, body.pieces), closed.holes,
        body.thin, tuple(warnings),
    )  # fmt: skip


def _carry(mesh: Mesh, stance: _Stance) -> Mesh:
    """Return the body at zero, whose vertices have the colours of the nearest ones."""
    from scipy.spatial import cKDTree  # scipy takes its time

    body = stance.body
    places = body.vertices - body.vertices.min(axis=0)
    made = Mesh(places, body.faces)
    if mesh.colours is not None:
        nearest = cKDTree(stance.places).query(body.vertices)[1]
        vertices = replace(find_vertices(mesh).take(nearest), positions=places)
        made = make_mesh(vertices, body.faces, np.zeros(3))
    if not check_mesh(made).watertight:
        raise JobError("the print is not closed and manifold", "report this with the mesh")
    return made
