"""What changed between two epochs for people: a table, a page and a picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from hpcapp.applications.compare.volume.epochs import MeasuredChange
from hpcapp.applications.compare.volume.measure import Change, SolidChange, Volume, list_volumes
from hpcapp.geometry.points import ByteArray, FloatArray
from hpcapp.pages.drawing.camera import look_along
from hpcapp.pages.drawing.caption import Colour, add_caption
from hpcapp.pages.drawing.scale_bar import add_scale_bar
from hpcapp.pages.page import build_page, tabulate
from hpcapp.pages.png import write_png
from hpcapp.pages.render import draw_mesh
from hpcapp.pages.scene import Field, Scene, fields_of
from hpcapp.wording import say_number

HEAD = ("", "volume", "uncertainty", "area", "")
_CUT, _SAME, _FILL, _UNKNOWN = (38, 92, 186), (236, 236, 232), (196, 42, 38), (150, 150, 150)
_TOP = 0.95  # share of what changed that the colours tell apart
_SIZE = 1000  # pixels along a side
_SIDES = {Change: ("cut", "fill"), SolidChange: ("inside OLD", "outside of OLD")}
_EYE = (-120.0, 50.0)  # azimuth and elevation, in degrees


def list_rows(change: Change | SolidChange, unit: str) -> list[tuple[str, str, str, str, str]]:
    """Return the rows of a table: name, volume, uncertainty, area, and what is no change."""
    cubed, squared = _raise_unit(unit)
    return [
        (name, say_number(one.volume, cubed), f"± {say_number(one.uncertainty, cubed)}",
         say_number(one.area, squared), _judge(one))
        for name, one in list_volumes(change).items()
    ]  # fmt: skip


def _judge(volume: Volume) -> str:
    if volume.is_significant:
        return ""
    return "a change or a shift" if volume.is_shift else "no change is told"


def list_notes(change: Change | SolidChange, unit: str) -> list[str]:
    """Return what the volumes mean, and what they leave out, a sentence each."""
    _, squared = _raise_unit(unit)

    def say(number: float) -> str:
        return say_number(number, unit)

    moved = ", ".join(say_number(along) for along in change.shift)
    known = (
        f"{100.0 * change.confidence:.0f} % of such volumes are off by their uncertainty at most"
    )
    where = (
        f"where they agree best, NEW is shifted by {moved}{f' {unit}' if unit else ''} (x, y, z) "
        f"and scatters by {say(change.noise)}"
    )
    if isinstance(change, SolidChange):
        return [
            known,
            f"{where}; it lies {say(change.offset)} outside of OLD all over",
            "both are closed: net is what NEW encloses less what OLD encloses, and does not depend "
            "on where they lie",
        ]
    return [
        known,
        f"{where}; from {say(change.detectable)} on three by three cells have changed, and more of "
        "them from less on: what stays below is in the uncertainties",
        f"both cover {say_number(change.common, squared)} in cells {say(change.cell)} wide; "
        f"nothing is counted on {say_number(change.only_new, squared)} that only NEW covers, and "
        f"on {say_number(change.only_old, squared)} that only OLD covers",
    ]


def doubt(change: Change | SolidChange, unit: str) -> str | None:
    """Say what a shift of the new epoch would explain, where that is most, or may be."""
    if isinstance(change, Change) and not change.agreed and change.registration is None:
        return (
            "no part of the ground has stayed as it was: nothing tells how well the two are "
            "registered, and no uncertainty holds it; if that is known, say it by --registration"
        )
    most = max(list_volumes(change).values(), key=lambda one: one.from_shift)
    if 2.0 * most.from_shift <= most.uncertainty:
        return None
    if isinstance(change, SolidChange):
        return (
            f"most of the uncertainty is that NEW lies {say_number(change.offset, unit)} outside "
            "of OLD all over, as other noise or another scanner makes it: if it did grow, say so "
            "by --registration 0"
        )
    moved = " ".join(say_number(along, unit) for along in change.shift)
    volume = say_number(most.from_shift, _raise_unit(unit)[0])
    return (
        f"a shift of NEW by {moved} would explain {volume} of the change: if the two are "
        "registered better than that, say how well by --registration; if not, register them"
    )


def make_page(new: str, old: str, measured: MeasuredChange, up: str) -> str:
    """Return a page (HTML) with the new surface, coloured by what changed."""
    mesh, values = measured.show()
    field = Field(
        "change", "Change", values, measured.unit, is_signed=True,
        sides=_SIDES[type(measured.change)], high=_find_end(measured.change, values),
    )  # fmt: skip
    scene = Scene(mesh, [field, *fields_of(mesh)], up=up, colouring="change", unit=measured.unit)
    notes = list_notes(measured.change, measured.unit)
    if doubted := doubt(measured.change, measured.unit):
        notes.insert(0, doubted)
    volumes = tabulate("Volumes", list_rows(measured.change, measured.unit), HEAD, notes)
    return build_page(Path(new).name, f"what changed since {old}", scene, [volumes])


def write_picture(path: Path, measured: MeasuredChange, up: str) -> None:
    """Draw the new surface, coloured by what changed, with the volumes.

    Raise OutputError where the file cannot be written.
    """
    mesh, values = measured.show()
    shown = replace(mesh, colours=_colour(values, _find_end(measured.change, values)))
    axes = look_along(*_EYE, up)
    picture, pixels_per_unit = draw_mesh(shown, axes, _SIZE, up)
    lines: list[tuple[Colour | None, str]] = [
        (None, f"{name}  {volume} {uncertainty}  {told or f'on {area}'}")
        for name, volume, uncertainty, area, told in list_rows(measured.change, measured.unit)
    ]
    lines += zip((_CUT, _FILL), _SIDES[type(measured.change)], strict=True)
    if not np.isfinite(values).all():
        lines.append((_UNKNOWN, "not in OLD"))
    write_png(path, add_caption(add_scale_bar(picture, pixels_per_unit, measured.unit), lines))


def _find_end(change: Change | SolidChange, values: FloatArray) -> float:
    """Return the change that has the darkest colour: most of those that are one are below."""
    changed = np.abs(values[np.abs(np.nan_to_num(values)) > change.detectable])
    return float(np.quantile(changed, _TOP)) if len(changed) else change.detectable or 1.0


def _colour(values: FloatArray, end: float) -> ByteArray:
    """Return colours from blue (cut) by white to red (fill), grey where nothing is known."""
    share = np.clip(np.nan_to_num(values) / end, -1.0, 1.0)[:, None]
    ends = np.where(share < 0.0, np.array(_CUT), np.array(_FILL))
    mixed = np.abs(share) * ends + (1.0 - np.abs(share)) * np.array(_SAME)
    mixed[~np.isfinite(values)] = _UNKNOWN
    colours: ByteArray = np.rint(mixed).astype(np.uint8)
    return colours


def _raise_unit(unit: str) -> tuple[str, str]:
    return (f"{unit}³", f"{unit}²") if unit else ("", "")
