"""Where points were measured from: the evidence for the side of their normals."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from hpcapp.applications.surface.normals.viewpoint import TIMED, Viewpoint
from hpcapp.geometry.axes import rotate
from hpcapp.geometry.paths import MOST_PLACES, thin_path
from hpcapp.geometry.points import FloatArray
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

SensorKind = Literal["unknown", "above", "below", "inside", "outside", "places"]

# Whether cameras and points are in the same coordinates. Of 37 clouds and corners of clouds, seen
# from around, above or inside, the nearest camera is 0.7 extents away or less, and all points lie
# before one; two photographs, 1 apart, of a spot 12 below them come to 12. Beside the coordinates
# of a map (45 pairs) the cameras are 50 extents away or more; below what they look down at (6),
# they have nothing before them. One photograph from amid the points has half of them.
_FARTHEST = 20.0  # times what the points and the cameras extend, together
_BEFORE = 0.2  # share of the points that lie before a camera


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """What is known of where points were measured from.

    The kinds ``above`` and ``below`` mean along what is up, ``inside`` a room or a tunnel,
    ``outside`` all around. With the kind ``places``, and only there, `places` (s, 3) are where it
    stood, in the file's coordinates, and `axes` (s, 3) along which direction cameras looked from
    there; zero where nobody knows. It `is_told` by the user, or else by the file. Where z is not
    up, the rows of `upright` (3, 3) are to the east, to the north and up: see `find_upright`.
    """

    kind: SensorKind = "unknown"
    places: FloatArray | None = None
    axes: FloatArray | None = None
    is_told: bool = False
    upright: FloatArray | None = None

    def rotate(self) -> Sensor:
        """Return the same to the east, to the north and up."""
        places, axes = (
            None if rows is None else rotate(rows, self.upright)
            for rows in (self.places, self.axes)
        )
        return replace(self, places=places, axes=axes)

    @property
    def noun(self) -> str:
        """What was in its places, for people."""
        is_camera = self.axes is not None and bool(self.axes.any())
        return "cameras were" if is_camera else "scanner stood"

    def scale_heights(self, factor: float) -> Sensor:
        """Return the same where heights are multiplied by a factor."""
        scales = np.array([1.0, 1.0, factor])
        return replace(
            self,
            places=None if self.places is None else self.places * scales,
            axes=None if self.axes is None else self.axes / scales,  # planes across them stay
        )

    def check_sight(self, points: FloatArray, zero: FloatArray) -> None:
        """Refuse, by an InputError, cameras that are far from the points or look elsewhere.

        `points`, (n, 3), are from all over the cloud; there, the input has (0, 0, 0) at `zero`.
        """
        if self.places is None or self.axes is None or not self.axes.any():
            return
        is_camera = self.axes.any(axis=1)
        places, axes = self.places[is_camera] + zero, self.axes[is_camera]
        low, high = points.min(axis=0), points.max(axis=0)
        # (c, 3): from each camera to the box of the points; 0 along an axis where it is within.
        gaps = np.maximum(np.maximum(low - places, places - high), 0.0)
        nearest = float(np.sqrt(np.einsum("ni,ni->n", gaps, gaps).min()))
        size = float(np.linalg.norm(high - low) + np.linalg.norm(np.ptp(places, axis=0)))
        # (n,): whether any of the cameras looks towards the point.
        is_before = np.zeros(len(points), np.bool_)
        for place, axis in zip(places, axes, strict=True):
            is_before |= (points - place) @ axis > 0.0
        if nearest > _FARTHEST * size:
            seen = f"the nearest is {nearest:.3g} away, {nearest / size:.0f} times their extent"
        elif is_before.mean() < _BEFORE:
            seen = f"{100.0 * is_before.mean():.0f} % of the points lie before one"
        else:
            return
        raise InputError(
            f"the cameras ({name_option('viewpoint')}) did not see these points: {seen}",
            "export both in the same coordinates: of a map, or local",
        )


def find_path(viewpoint: Viewpoint) -> FloatArray:
    """Return the places whose times are said, as time goes on, with it last, shape (n, 4)."""
    places = () if isinstance(viewpoint, str) else viewpoint
    path = np.array([place for place in places if len(place) == TIMED]).reshape(-1, TIMED)
    return path[np.argsort(path[:, 3], kind="stable")]


def sensor_of(viewpoint: Viewpoint, upright: FloatArray | None = None) -> Sensor:
    """Return what a user says of where points were measured from."""
    if isinstance(viewpoint, str):
        return Sensor(viewpoint, is_told=True, upright=upright)
    if not viewpoint:
        return Sensor(upright=upright)
    path = find_path(viewpoint)
    others = [(*place, 0.0, 0.0, 0.0)[:6] for place in viewpoint if len(place) != TIMED]
    thin = thin_path(path, MOST_PLACES)[:, :3]
    rows = np.concatenate([np.array(others).reshape(-1, 6), np.pad(thin, ((0, 0), (0, 3)))])
    return Sensor("places", rows[:, :3], rows[:, 3:], is_told=True, upright=upright)
