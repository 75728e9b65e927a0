"""Cut, fill and net volume between two epochs, and how sure they are."""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from math import hypot

import numpy as np

from hpcapp.applications.compare.volume.changed import find_changed
from hpcapp.applications.compare.volume.errors import (
    CONFIDENCE,
    LIKELY,
    Errors,
    Samples,
    find_errors,
)
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True)
class Volume:
    """A volume, and what holds it.

    Parameters
    ----------
    volume : float
        In cubed length units.
    uncertainty : float
        At the confidence of the `Change`, either way; of nothing, what a single cell would need to
        be told.
    from_shift : float
        What of the uncertainty is the shift that was measured where nothing changed.
    area : float
        That holds it, in squared length units.
    """

    volume: float
    uncertainty: float
    from_shift: float
    area: float

    @property
    def is_significant(self) -> bool:
        """Whether it is more than its uncertainty."""
        return abs(self.volume) > self.uncertainty


@dataclass(frozen=True, slots=True)
class Change:
    """What two epochs of a terrain differ by.

    Parameters
    ----------
    cut, fill, net : Volume
        What is gone, what was added, and the second less the first.
    common, only_new, only_old : float
        Areas where both epochs have support, and where only one has: there nothing is counted.
    layered : float
        Area with several heights over one place, of which the highest or the mean counts.
    shift : tuple of 3 floats
        Of the new epoch against the old one, where nothing changed, along x, y and z.
    registration : float or None
        What the user says of it.
    noise : float
        Standard deviation of a difference where nothing changed.
    detectable : float
        The smallest difference that is a change by itself.
    cell : float
        Width of a cell.
    confidence : float
        Share of the volumes that are within their uncertainty.
    """

    cut: Volume
    fill: Volume
    net: Volume
    common: float
    only_new: float
    only_old: float
    layered: float
    shift: tuple[float, float, float]
    registration: float | None
    noise: float
    detectable: float
    cell: float
    confidence: float = CONFIDENCE


@dataclass(frozen=True, slots=True)
class SolidChange:
    """What two closed meshes differ by.

    Parameters
    ----------
    new, old, net : Volume
        What they enclose, and the first less the second; of the areas of their surfaces.
    shift : tuple of 3 floats
        Of the new mesh against the old one, where nothing changed, along x, y and z.
    offset : float
        How far all of the new surface lies outside of the old one, where nothing changed.
    registration : float or None
        What the user says of it.
    noise : float
        Standard deviation of a distance where nothing changed.
    detectable : float
        The smallest distance that noise alone does not make.
    confidence : float
        Share of the volumes that are within their uncertainty.
    """

    new: Volume
    old: Volume
    net: Volume
    shift: tuple[float, float, float]
    offset: float
    registration: float | None
    noise: float
    detectable: float
    confidence: float = CONFIDENCE


def measure_samples(
    samples: Samples, pairs: IntArray, registration: float | None
) -> tuple[Errors, IntArray, tuple[Volume, Volume, Volume]]:
    """Return the errors, the side of each piece that changed, and cut, fill and net volume."""
    errors = find_errors(samples, registration)
    side = find_changed(samples, errors, pairs)
    cut, fill, net = (
        _sum_volume(samples, errors, rows)
        for rows in (np.flatnonzero(side < 0), np.flatnonzero(side > 0), np.flatnonzero(side))
    )
    return errors, side, (replace(cut, volume=0.0 - cut.volume), fill, net)


def _sum_volume(samples: Samples, errors: Errors, rows: IntArray) -> Volume:
    if not len(rows):  # the smallest that would be told is uncertain
        return Volume(0.0, samples.area * float(np.median(errors.detect(samples))), 0.0, 0.0)
    volume = samples.area * float(samples.change[rows].sum())
    bias = errors.sum_bias(samples, rows)
    return Volume(
        volume, bias + errors.sum_noise(samples, rows), bias, samples.area * len(rows)
    )  # fmt: skip


def widen(change: Change, coarse: Change) -> Change:
    """Return a change whose uncertainties hold what the width of cells makes of it.

    Errors of cells grow with the square of their width: with double the width volumes are three
    times their error away.

    Parameters
    ----------
    coarse : Change
        Of cells of double the width.
    """

    def widen_one(fine: Volume, other: Volume) -> Volume:
        off = LIKELY * (fine.volume - other.volume) / 3.0
        return replace(fine, uncertainty=hypot(fine.uncertainty, off))

    return replace(
        change,
        cut=widen_one(change.cut, coarse.cut),
        fill=widen_one(change.fill, coarse.fill),
        net=widen_one(change.net, coarse.net),
    )


def list_volumes(change: Change | SolidChange) -> dict[str, Volume]:
    """Return the volumes of a change by their names."""
    values = {field.name: getattr(change, field.name) for field in fields(change)}
    return {name: value for name, value in values.items() if isinstance(value, Volume)}


def as_json(change: Change | SolidChange, unit: str) -> dict[str, object]:
    """Return a change as plain values."""
    volumes = {
        name: asdict(one) | {"is_significant": one.is_significant}
        for name, one in list_volumes(change).items()
    }
    return asdict(change) | volumes | {"unit": unit or None}


def name_shift(shift: FloatArray) -> tuple[float, float, float]:
    """Return a shift as plain numbers."""
    x, y, z = shift[:3].tolist()
    return x, y, z
