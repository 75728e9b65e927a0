"""Formats that points are written to: one line each, with what a file of it holds."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from hpcapp.io.crs import UNIT_CODES, parse_epsg
from hpcapp.io.e57.writer import write_e57
from hpcapp.io.las.writer import write_las
from hpcapp.io.ply.format import write_ply_points
from hpcapp.io.points.npz_writer import write_npz_points
from hpcapp.io.points.point_source import Scan
from hpcapp.io.text.writer import write_text_points
from hpccomponent.surface.types.points import PointCloud

__all__ = ["POINT_WRITERS", "PointWriter"]

Write = Callable[[Path, PointCloud, str | None, str | None, Sequence[Scan]], None]

_LONGEST = 40  # characters of a coordinate system in a message


@dataclass(frozen=True, slots=True)
class PointWriter:
    """A format that points are written to.

    Parameters
    ----------
    write : callable
        Writes a cloud with its coordinate reference system, its unit and its scans.
    choose_attributes : callable, optional
        Names the only attributes of a cloud that it holds; all by default.
    holds_crs : callable, optional
        Tells whether it holds a coordinate reference system; it holds none by default.
    holds_unit : callable, optional
        Tells whether it holds a unit, given the coordinate reference system, too.
    holds_scanners : bool
        Whether it holds where the scanners stood.
    """

    write: Write
    choose_attributes: Callable[[PointCloud], Collection[str]] | None = None
    holds_crs: Callable[[str], bool] = lambda _: False
    holds_unit: Callable[[str, str | None], bool] = lambda *_: False
    holds_scanners: bool = False

    def find_losses(
        self, cloud: PointCloud, crs: str | None, unit: str | None, scans: Sequence[Scan]
    ) -> list[str]:
        """Return what a file of this format does not hold.

        Returns
        -------
        list of str
            Names of attributes, and words for the rest.
        """
        lost: list[str] = []
        if self.choose_attributes is not None:
            held = self.choose_attributes(cloud)
            lost += [name for name in cloud.attributes if name not in held]
        if crs and not self.holds_crs(crs):
            shown = crs if len(crs) <= _LONGEST else f"{crs[:_LONGEST]}..."
            lost.append(f"CRS ({shown})")
        if unit and not self.holds_unit(unit, crs):
            lost.append(f"unit ({unit})")
        if not self.holds_scanners and any(scan.scanner is not None for scan in scans):
            lost.append("scanner positions")
        return lost


def _is_wkt(crs: str) -> bool:
    return "[" in crs


def _choose_for_text(cloud: PointCloud) -> Collection[str]:
    return ("intensity",) if cloud.colours is not None and cloud.normals is None else ()


def _is_in_las(crs: str) -> bool:
    return _is_wkt(crs) or parse_epsg(crs) is not None


def _is_unit_in_las(unit: str, crs: str | None) -> bool:
    return unit in UNIT_CODES or (crs is not None and _is_in_las(crs))


_PLY = PointWriter(
    write_ply_points,
    holds_crs=lambda _: True,
    holds_unit=lambda *_: True,
    holds_scanners=True,
)
_TEXT = PointWriter(
    lambda path, cloud, *_: write_text_points(path, cloud), choose_attributes=_choose_for_text
)
_LAS = PointWriter(
    lambda path, cloud, crs, unit, _: write_las(path, cloud, crs, unit),
    holds_crs=_is_in_las,
    holds_unit=_is_unit_in_las,
)
_E57 = PointWriter(
    lambda path, cloud, crs, *_: write_e57(path, cloud, crs),
    choose_attributes=lambda _: ("intensity",),
    holds_crs=_is_wkt,
    holds_unit=lambda unit, _: unit == "m",
)
_NPZ = PointWriter(lambda path, cloud, *_: write_npz_points(path, cloud))

POINT_WRITERS = {
    ".ply": _PLY,
    **dict.fromkeys((".xyz", ".txt", ".asc", ".pts"), _TEXT),  # blanks separate in any program
    ".las": _LAS,
    ".laz": _LAS,
    ".e57": _E57,
    ".npz": _NPZ,
}
"""By suffix."""
