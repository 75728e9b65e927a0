"""Scanners: where each pulse starts, where it goes, and when."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.lab.simulate.raw.scenes import RawScene
from hpcapp.lab.simulate.rays import frame_about, unit_vectors
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

_STRIPS, _ALTITUDE, _SPEED, _TURN_S = 2, 200.0, 20.0, 20.0  # metres, metres a second
_LOWEST, _HIGHEST = -60.0, 90.0  # degrees above the horizon, of a tripod
_STAND_S, _MOVE_S = 20.0, 300.0
_FRAMES, _FRAME_S = 120, 0.5
_SHOTS, _SHOT_S, _SHOT_DISTANCE = 16, 10.0, 1.5  # diagonals


@dataclass(frozen=True, slots=True, eq=False)
class Pulses:
    """What a scanner sends out, in the order of time.

    Parameters
    ----------
    origins, directions : ndarray of float64, shape (n, 3)
    times : ndarray of float64, shape (n,)
        In seconds.
    angles : ndarray of float64, shape (n,)
        Of the mirror, in degrees from straight down.
    sources : ndarray of int64, shape (n,)
        Number of the strip, stand, frame or shot, from 1.
    """

    origins: FloatArray
    directions: FloatArray
    times: FloatArray
    angles: FloatArray
    sources: IntArray


Aim = Callable[[RawScene, int, np.random.Generator], Pulses]


@dataclass(frozen=True, slots=True)
class Scanner:
    """A kind of scanner. Lengths are in units of the scene.

    Parameters
    ----------
    scenes : tuple of str
        Those that it can scan.
    aim : callable
        Returns about so many pulses over a scene.
    noise : float
        Standard deviation of the distance that is measured.
    noise_growth : float
        What is added to it for the square of the distance.
    reach : float
        The longest distance that is measured.
    grazing : float
        Angle of incidence from which on nothing comes back, in degrees.
    drift_s : float
        Seconds over which its position drifts.
    tells_returns : bool
        Whether it counts the returns of a pulse.
    """

    name: str
    scenes: tuple[str, ...]
    aim: Aim
    noise: float
    noise_growth: float
    reach: float
    grazing: float
    drift_s: float
    tells_returns: bool


def find_scanner(name: str | None, scene: str) -> Scanner:
    """Return a scanner for a scene: the usual one without a name.

    Raise UsageError where the name is unknown, or that scanner cannot scan the scene.
    """
    fitting = [one.name for one in SCANNERS.values() if scene in one.scenes]
    if name is None:
        name = fitting[0]
    if name not in SCANNERS:
        raise UsageError(f"there is no scanner named {name!r}", f"choose {' or '.join(fitting)}")
    if name not in fitting:
        raise UsageError(
            f"a scene of the kind {scene!r} cannot be scanned by {name!r}",
            f"choose {' or '.join(fitting)}",
        )
    return SCANNERS[name]


def _fly(scene: RawScene, count: int, rng: np.random.Generator) -> Pulses:
    """Fly strips along x, there and back, with a mirror that turns across the flight."""
    del rng
    low, high = scene.bounds
    size, altitude = high - low, high[2] + _ALTITUDE
    each = max(count // _STRIPS, 1)
    lines = max(round(float(np.sqrt(each * size[0] / size[1]))), 1)
    # (p,): how far along its strip a pulse is sent, and how far across
    along = (np.arange(each) + 0.5) / each
    across = along * lines % 1.0
    parts = []
    for strip in range(_STRIPS):
        y = low[1] + size[1] * (strip + 0.5) / _STRIPS
        edges = np.arctan2(np.array([low[1], high[1]]) - y, altitude - low[2])
        angles = edges[0] + across * (edges[1] - edges[0])
        x = low[0] + size[0] * (1.0 - along if strip % 2 else along)
        origins = np.column_stack([x, np.full(each, y), np.full(each, altitude)])
        directions = np.column_stack([np.zeros(each), np.sin(angles), -np.cos(angles)])
        times = strip * (size[0] / _SPEED + _TURN_S) + along * size[0] / _SPEED
        sources = np.full(each, strip + 1)
        parts.append(Pulses(origins, directions, times, np.degrees(angles), sources))
    return _join(parts)


def _turn(scene: RawScene, count: int, rng: np.random.Generator) -> Pulses:
    """Turn once on each stand, in even steps of azimuth and elevation."""
    assert scene.stands is not None  # noqa: S101 - of all scenes that it can scan
    each = max(count // len(scene.stands), 1)
    columns = max(float(np.sqrt(each * 360.0 / (_HIGHEST - _LOWEST))), 1.0)
    # (p,): how much of the turn is done, and of the way up
    done = (np.arange(each) + 0.5) / each
    elevation = np.radians(_LOWEST + (_HIGHEST - _LOWEST) * (done * columns % 1.0))
    parts = []
    for number, stand in enumerate(scene.stands):
        azimuth = 2.0 * np.pi * (done + rng.random())
        flat = np.cos(elevation)
        directions = np.column_stack(
            [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]
        )
        times = number * _MOVE_S + done * _STAND_S
        angles, sources = np.degrees(elevation) + 90.0, np.full(each, number + 1)
        parts.append(Pulses(np.tile(stand, (each, 1)), directions, times, angles, sources))
    return _join(parts)


def _walk(scene: RawScene, count: int, rng: np.random.Generator) -> Pulses:
    """Walk with a depth camera: frames of pixels that are spread by chance."""
    assert scene.walk is not None  # noqa: S101 - of all scenes that it can scan
    each = max(count // _FRAMES, 1)
    frame = np.repeat(np.arange(_FRAMES), each)
    eyes, targets = scene.walk((frame + 0.5) / _FRAMES)
    ahead = unit_vectors(targets - eyes)
    side = unit_vectors(np.cross(ahead, [0.0, 0.0, 1.0]))
    aside, above = rng.uniform(-1.0, 1.0, (2, len(frame), 1)) * np.array([[[0.6]], [[0.45]]])
    directions = unit_vectors(ahead + aside * side + above * np.cross(side, ahead))
    return Pulses(
        eyes, directions, _FRAME_S * frame.astype(np.float64), np.zeros(len(frame)), frame + 1
    )


def _shoot(scene: RawScene, count: int, rng: np.random.Generator) -> Pulses:
    """Take shots from all round: each a square image that covers the object."""
    low, high = scene.bounds
    # (16, 3): a golden spiral on the sphere
    height = 1.0 - 2.0 * (np.arange(_SHOTS) + 0.5) / _SHOTS
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(_SHOTS)
    ring = np.sqrt(1.0 - height**2)
    sphere = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    ahead = -sphere @ np.linalg.qr(rng.standard_normal((3, 3)))[0].T
    side, up = frame_about(ahead)
    pixels = max(round(float(np.sqrt(count / _SHOTS))), 1)
    shot = np.repeat(np.arange(_SHOTS), pixels**2)
    # (p, 2): where in its image a pulse points, from -1 to 1
    row, column = np.divmod(np.arange(len(shot)) % pixels**2, pixels)
    spot = np.column_stack([column, row]) + rng.uniform(0.2, 0.8, (len(shot), 2))
    spot = (2.0 * spot / pixels - 1.0) * np.tan(np.arcsin(0.5 / _SHOT_DISTANCE))
    directions = unit_vectors(ahead[shot] + spot[:, :1] * side[shot] + spot[:, 1:] * up[shot])
    origins = 0.5 * (low + high) - _SHOT_DISTANCE * scene.unit * ahead[shot]
    return Pulses(
        origins, directions, _SHOT_S * shot.astype(np.float64), np.zeros(len(shot)), shot + 1
    )


_OUTDOORS = ("terrain", "yard", "heap", "forest", "town")

SCANNERS: Mapping[str, Scanner] = MappingProxyType(
    {
        one.name: one
        for one in (
            Scanner("airborne", _OUTDOORS, _fly, 0.03, 0.0, 1000.0, 88.0, 5.0, True),
            Scanner(
                "terrestrial", (*_OUTDOORS, "room"), _turn, 0.002, 0.0, 200.0, 88.0, 100.0, True
            ),
            Scanner("structured-light", ("object",), _shoot, 0.0005, 0.0, 3.0, 80.0, 2.0, False),
            Scanner("handheld", ("room", "object"), _walk, 0.002, 0.0015, 5.0, 82.0, 15.0, False),
        )
    }
)
"""By name; the first that can scan a scene is the usual one."""


def _join(parts: list[Pulses]) -> Pulses:
    return Pulses(
        np.concatenate([part.origins for part in parts]),
        np.concatenate([part.directions for part in parts]),
        np.concatenate([part.times for part in parts]),
        np.concatenate([part.angles for part in parts]),
        np.concatenate([part.sources for part in parts]),
    )
