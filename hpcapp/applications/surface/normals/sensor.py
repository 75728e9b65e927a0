"""Where points were measured from: the evidence for the side of their normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from hpcapp.applications.surface.types.points import FloatArray

__all__ = ["Sensor", "SensorKind"]

SensorKind = Literal["unknown", "above", "below", "inside", "outside", "places"]


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """What is known of where points were measured from.

    Parameters
    ----------
    kind : str
        ``above`` and ``below`` mean along z, ``inside`` a room or a tunnel, ``outside`` all around.
    places : ndarray of float64, shape (s, 3), or None
        Where it stood, in the file's coordinates; with the kind ``places``, and only there.
    is_told : bool
        Whether the user has said so; else the file has.
    """

    kind: SensorKind = "unknown"
    places: FloatArray | None = None
    is_told: bool = False
