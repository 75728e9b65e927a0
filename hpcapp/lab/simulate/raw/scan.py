"""A raw scan: pulses of a scanner, what comes back of them, and what goes wrong.

::

    scene -> pulses -> first surface -> returns of crowns before it -> as many as are wanted
                                                                              |
          trajectory, points <- drift <- strays <- noise <- flying pixels at edges

One seed gives one scan.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray, PointCloud
from hpcapp.lab.simulate.faults import draw_drift, strew_outliers
from hpcapp.lab.simulate.raw.edges import Sights, find_edges
from hpcapp.lab.simulate.raw.parts import OTHER, VEGETATION
from hpcapp.lab.simulate.raw.scanners import Pulses, Scanner, find_scanner
from hpcapp.lab.simulate.raw.scenes import SCENES, RawScene
from hpcapp.lab.simulate.rays import cross_rays
from hpcapp.lab.simulate.settings import MOST_POINTS, check_ranges
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

_LOST = 0.02  # share of the pulses of which nothing comes back
_FADING = 20.0  # degrees before the grazing angle over which returns become fewer
_TRAIL = 0.3  # units that pixels fly behind an edge
_PILOT = 2000  # pulses that tell how many are needed
_MOST_PULSES = 20  # by point: above it a scan would take for ever
_START_S = 300_000.0  # of the week
_TICK_S = 0.1  # between two rows of a trajectory
_NONE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class RawSettings:
    """How a scene is scanned.

    Parameters
    ----------
    points : int
        Exactly as many, whatever is among them.
    noise : float or None
        Standard deviation of the distance, in length units; the scanner's own without it.
    flying, strays : float
        Shares of the points that lie behind an edge in the air, and that are outliers.
    drift : float
        Standard deviation of the scanner's position along each axis, in length units.
    shape : str
        The model that an object is.
    """

    points: int = 100_000
    noise: float | None = None
    flying: float = 0.0
    strays: float = 0.0
    drift: float = 0.0
    seed: int = 0
    shape: str = "bust"

    def __post_init__(self) -> None:
        check_ranges(
            self,
            {
                "points": (1, MOST_POINTS),
                "flying": (0.0, 0.5),
                "strays": (0.0, 0.5),
                "drift": (0.0, np.inf),
                "seed": (0, np.inf),
            },
        )
        if self.noise is not None:
            check_ranges(self, {"noise": (0.0, np.inf)})


@dataclass(frozen=True, slots=True, eq=False)
class RawScan:
    """What a scanner delivers, and the truth.

    The cloud is without normals, in the order of time; the trajectory (n, 4) is time in seconds and
    x, y, z, where the scanner believes it was; the truth has the ``classification`` of each vertex.
    Flying and stray points, (len(cloud),), lie on nothing.
    """

    cloud: PointCloud
    trajectory: FloatArray
    truth: Mesh
    is_flying: BoolArray
    is_stray: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class _Returns:
    """What came back: of which pulse, ascending, from how far, and of what class."""

    pulse: IntArray
    distance: FloatArray
    kind: IntArray

    def take(self, rows: IntArray) -> _Returns:
        return _Returns(self.pulse[rows], self.distance[rows], self.kind[rows])

    def count(self) -> tuple[IntArray, IntArray]:
        """Return the number of each within its pulse, from 1, and how many the pulse has."""
        total = np.bincount(self.pulse)
        first = np.cumsum(total) - total
        return np.arange(len(self.pulse)) - first[self.pulse] + 1, total[self.pulse]

    @staticmethod
    def merge(one: _Returns, other: _Returns) -> _Returns:
        both = _Returns(
            np.concatenate([one.pulse, other.pulse]),
            np.concatenate([one.distance, other.distance]),
            np.concatenate([one.kind, other.kind]),
        )
        return both.take(np.lexsort((both.distance, both.pulse)))


def scan_scene(scene: str, scanner: str | None, settings: RawSettings | None = None) -> RawScan:
    """Scan one of `SCENES` by one of `SCANNERS`, by default the scene's usual one.

    Raise UsageError where a name is unknown, the scanner cannot scan the scene, or hardly any pulse
    comes back.

    Examples
    --------
    >>> raw = scan_scene("terrain", "airborne", RawSettings(points=500))
    >>> len(raw.cloud), raw.cloud.normals is None
    (500, True)
    """
    settings = settings or RawSettings()
    if scene not in SCENES:
        raise UsageError(f"there is no scene named {scene!r}", f"choose one of {', '.join(SCENES)}")
    device = find_scanner(scanner, scene)
    rng = np.random.default_rng(settings.seed)
    place = SCENES[scene](rng, settings.shape)
    pulses, returns, is_flying = _gather(place, device, settings, rng)
    # (n, 3): rays of the returns, and the points along them
    rays = pulses.directions[returns.pulse]
    noise = rng.standard_normal(len(rays)) * _noise_at(returns.distance, place, device, settings)
    positions = pulses.origins[returns.pulse] + (returns.distance + noise)[:, None] * rays
    is_stray = np.zeros(len(rays), dtype=bool)
    solid = np.flatnonzero(~is_flying)
    share = settings.strays * len(rays) / len(solid)
    positions[solid], is_stray[solid] = strew_outliers(
        place.surface, share, positions[solid], rays[solid], rng
    )
    path = _sample_path(pulses)
    if settings.drift:
        times = np.concatenate([pulses.times[returns.pulse], path[:, 0]])
        moves = settings.drift * _draw_moves(times / device.drift_s, rng)
        positions += moves[: len(positions)]
        path[:, 1:] += moves[len(positions) :]
    path[:, 0] += _START_S
    kind = np.where(is_flying | is_stray, OTHER, returns.kind)
    attributes = _describe(pulses, returns, kind, device.tells_returns)
    cloud = PointCloud(positions, attributes=attributes)
    return RawScan(cloud, path, place.truth, is_flying, is_stray)


def _gather(
    scene: RawScene, scanner: Scanner, settings: RawSettings, rng: np.random.Generator
) -> tuple[Pulses, _Returns, BoolArray]:
    """Send more pulses until enough comes back; return as much as is wanted, and what flies."""
    want = round(settings.flying * settings.points)
    solid, most = settings.points - want, _MOST_PULSES * (settings.points + _PILOT)
    count = _PILOT
    while True:
        pulses = scanner.aim(scene, count, rng)
        returns, hits = _meet(scene, scanner, pulses, rng)
        edges, gaps = find_edges(
            scene.surface, scene.unit, hits if want else hits.take(_NONE), scene.border, rng
        )
        drawn = np.sort(rng.permutation(len(gaps))[:want])
        edges, gaps = edges.take(drawn), gaps[drawn]
        rest = returns.take(np.flatnonzero(~np.isin(returns.pulse, edges.rows)))
        if len(gaps) == want and len(rest.pulse) >= solid:
            break
        lack = max(want / max(len(gaps), 1), solid / max(len(rest.pulse), 1))
        needed = int(1.1 * count * lack) + 1000
        if needed > most and count >= settings.points:
            raise _say_lack(count, len(gaps), want, len(rest.pulse), solid)
        count = min(needed, 10 * count)
    # (want,): what flies lies near its edge rather than at the end of the trail
    away = np.minimum(gaps, _TRAIL * scene.unit) * rng.random(want) ** 1.3
    wild = _Returns(edges.rows, edges.distances + away, np.full(want, OTHER))
    pulses.directions[edges.rows] = edges.directions
    every = _Returns.merge(_choose(rest, solid, rng), wild)
    return pulses, every, np.isin(every.pulse, wild.pulse)


def _say_lack(count: int, edges: int, flying: int, returns: int, solid: int) -> UsageError:
    if edges < flying:
        return UsageError(
            f"only {edges} of {count} pulses met an edge, {flying} are to fly behind one",
            f"ask for a smaller {name_option('flying')}",
        )
    return UsageError(
        f"only {returns} of {count} pulses came back, {solid} are wanted", "ask for fewer points"
    )


def _meet(
    scene: RawScene, scanner: Scanner, pulses: Pulses, rng: np.random.Generator
) -> tuple[_Returns, Sights]:
    """Return what comes back of pulses, and the hits of the surface alone."""
    surface, reach = scene.surface, scanner.reach * scene.unit
    pulse, distance = cross_rays(surface, pulses.origins, pulses.directions, reach, first_only=True)
    rays = pulses.directions[pulse]
    hits = pulses.origins[pulse] + distance[:, None] * rays
    # (h,): which of the hits echo, the fewer the more the ray grazes
    cosine = np.abs(np.einsum("ij,ij->i", surface.normal(hits), rays))
    angle = np.degrees(np.arccos(np.minimum(cosine, 1.0)))
    fading = np.clip((scanner.grazing - angle) / _FADING, 0.0, 1.0)
    echoes = np.flatnonzero(rng.random(len(pulse)) < fading * (1.0 - _LOST))
    found = _Returns(pulse, distance, scene.classify(hits)).take(echoes)
    seen = Sights(pulse, pulses.origins[pulse], rays, distance).take(echoes)
    if scene.canopy is None:
        return found, seen
    way = np.full(len(pulses.times), reach)
    way[pulse] = distance
    struck, at, goes_on = scene.canopy.strike(pulses.origins, pulses.directions, way, rng)
    leaves = _Returns(struck, at, np.full(len(struck), VEGETATION))
    return _Returns.merge(leaves, found.take(np.flatnonzero(goes_on[found.pulse]))), seen


def _choose(returns: _Returns, count: int, rng: np.random.Generator) -> _Returns:
    """Keep so many returns, those of pulses drawn by chance; of the last one perhaps not all."""
    place = rng.permutation(returns.pulse.max(initial=0) + 1)[returns.pulse]
    return returns.take(np.sort(np.argsort(place, kind="stable")[:count]))


def _noise_at(
    distance: FloatArray, scene: RawScene, scanner: Scanner, settings: RawSettings
) -> FloatArray:
    """Return the standard deviation of each distance."""
    if settings.noise is not None:
        return np.full(len(distance), settings.noise)
    growth = scanner.noise_growth * (distance / scene.unit) ** 2
    return scene.unit * (scanner.noise + growth)


def _sample_path(pulses: Pulses) -> FloatArray:
    """Return time, x, y, z of a tenth of a second each, and of every end."""
    starts = np.unique(np.floor(pulses.times / _TICK_S), return_index=True)[1]
    ends = np.flatnonzero(np.diff(pulses.sources, append=0))
    rows = np.unique(np.concatenate([starts, ends]))
    rows = rows[np.unique(pulses.times[rows], return_index=True)[1]]
    return np.column_stack([pulses.times[rows], pulses.origins[rows]])


def _draw_moves(times: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return moves of standard deviation 1 along each axis, smooth over one unit of time."""
    clock = np.column_stack([times, np.zeros((len(times), 2))])
    view = np.zeros(len(times), dtype=np.int64)
    return np.stack([draw_drift(clock, view, 1.0, rng) for _ in range(3)], axis=1)


def _describe(
    pulses: Pulses, returns: _Returns, kind: IntArray, tells_returns: bool
) -> dict[str, NDArray[Any]]:
    """Return the columns that a scanner writes beside the coordinates."""
    columns: dict[str, NDArray[Any]] = {
        "gps_time": _START_S + pulses.times[returns.pulse],
        "point_source_id": pulses.sources[returns.pulse].astype(np.uint16),
    }
    if not tells_returns:
        return columns
    number, total = returns.count()
    return columns | {
        "return_number": number.astype(np.uint8),
        "number_of_returns": total.astype(np.uint8),
        "scan_angle": pulses.angles[returns.pulse].astype(np.float32),
        "classification": kind.astype(np.uint8),
    }
