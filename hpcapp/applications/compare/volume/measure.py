"""Cut, fill and net volume between two epochs, and how sure they are."""

from __future__ import annotations

from dataclasses import asdict, fields

from hpcapp.geometry.points import FloatArray
from hpcapp.terrain.errors import CONFIDENCE
from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True)
class Volume:
    """A volume, and what holds it.

    Parameters
    ----------
    volume : float
        In cubed length units.
    uncertainty : float
        At the confidence of the `Change`, either way.
    from_shift : float
        What of the uncertainty is a shift of the new epoch that part of the ground agrees upon. It
        is in the volume: ground that rose everywhere alike cannot be told from it.
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

    @property
    def is_shift(self) -> bool:
        """Whether it stands out of the noise, but may be a shift."""
        noise = self.uncertainty - self.from_shift
        return not self.is_significant and abs(self.volume) > noise


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
        Of the new epoch against the old one, along x, y and z: the least that part of the ground
        agrees upon.
    agreed : float
        Share of the common cells that it explains; zero where nothing tells a shift.
    registration : float or None
        What the user says of it.
    noise : float
        Standard deviation of the difference of a cell where they agree.
    detectable : float
        The smallest difference of three by three cells that is told for a change.
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
    agreed: float
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
