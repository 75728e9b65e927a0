"""``hpcapp.compare``, ``compare_epochs``, ``measure_heaps``: distances and volumes of the input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from numpy.typing import ArrayLike

from hpcapp.api.arrays import check_cloud
from hpcapp.api.mesh import Mesh, unwrap_mesh
from hpcapp.applications.compare.metrics import F_THRESHOLDS, Measures, as_json, measure_mesh
from hpcapp.applications.compare.truth import MeshTruth, PointTruth, Truth, open_truth
from hpcapp.applications.compare.volume import heap
from hpcapp.applications.compare.volume.epochs import measure_epochs
from hpcapp.applications.compare.volume.heap import Heap
from hpcapp.applications.compare.volume.measure import Change, SolidChange
from hpcapp.geometry import mesh as plain
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import formats
from hpcapp.io.outlines import read_polygons
from hpcapp.io.usable_mesh import check_usable
from hpcapp.terrain.epoch import Epoch, open_epoch
from hpccomponent.errors import InputError, UsageError
from hpccomponent.ranges import check_range

_LEAST_SAMPLES = 100


class Comparison:
    """How far a mesh is from the truth; lengths in units of the input.

    It is what `compare` returns.
    """

    def __init__(self, measures: Measures) -> None:
        self._measures = measures

    def _length(self, percent: float) -> float:
        return percent * self._measures.diagonal / 100.0

    @property
    def mean(self) -> float:
        """Mean of both directions; of an open truth, `completeness`."""
        return self._length(self._measures.l1)

    @property
    def accuracy(self) -> float:
        """Mean distance from the mesh to the truth; NaN where the truth is open."""
        return self._length(self._measures.accuracy)

    @property
    def completeness(self) -> float:
        """Mean distance from the truth to the mesh."""
        return self._length(self._measures.completeness)

    @property
    def rms(self) -> float:
        """Root of the mean square of both directions' distances."""
        return self._length(self._measures.rms)

    @property
    def p95(self) -> float:
        """95 of 100 distances are smaller."""
        return self._length(self._measures.p95)

    @property
    def hausdorff(self) -> float:
        """The largest distance met."""
        return self._length(self._measures.hausdorff)

    @property
    def f_scores(self) -> Mapping[str, float]:
        """Harmonic mean of precision and recall, by threshold in per cent of the diagonal."""
        return MappingProxyType(self._measures.f_scores)

    @property
    def normal_deg(self) -> float:
        """Mean angle between normals, in degrees; NaN where the truth has none."""
        return self._measures.normal_deg

    @property
    def diagonal(self) -> float:
        """Of the truth's bounding box."""
        return self._measures.diagonal

    @property
    def is_watertight(self) -> bool:
        """Whether the mesh is closed and manifold."""
        return self._measures.topology.watertight

    def to_json(self) -> dict[str, object]:
        """Return what ``hpcapp compare --json`` prints: lengths in per cent of the diagonal."""
        return as_json(self._measures)

    def __repr__(self) -> str:
        return (
            f"Comparison(mean {self.mean:.3g} ({self._measures.l1:.3g} % of the diagonal), "
            f"rms {self.rms:.3g}, 95 % below {self.p95:.3g}, largest {self.hausdorff:.3g})"
        )


def compare(
    mesh: Mesh | str | PathLike[str],
    truth: Mesh | PointCloud | ArrayLike | str | PathLike[str],
    *,
    samples: int = 50_000,
    seed: int = 0,
    thresholds: Sequence[float] = F_THRESHOLDS,
) -> Comparison:
    """Measure the distances between a mesh and the truth, as ``hpcapp compare`` does.

    Parameters
    ----------
    mesh : Mesh, str or PathLike
        A mesh, or its file.
    truth : Mesh, PointCloud, array_like of shape (n, 3), str or PathLike
        A mesh, points, the file of either, or ``shape:NAME``, a model of `simulate`.
    samples : int
        Points on either surface, 100 or more.
    seed : int
        One seed gives one result.
    thresholds : sequence of float
        Of F-scores, in per cent of the truth's diagonal.

    Raises
    ------
    InputError
        Nothing can be measured of one of them.
    UsageError
        Another argument is out of its range, or a suffix or shape is unknown.

    Examples
    --------
    >>> import hpcapp
    >>> mesh = hpcapp.reconstruct(hpcapp.simulate("torus", points=5000), grid=48)
    >>> result = hpcapp.compare(mesh, "shape:torus", samples=2000)
    >>> result.is_watertight, result.mean < 0.01 * result.diagonal
    (True, True)
    """
    check_range("samples", samples, _LEAST_SAMPLES)
    check_range("seed", seed, 0)
    for threshold in thresholds:
        check_range("thresholds", threshold, 0.0, is_open=True)
    surface = unwrap_mesh(mesh) if isinstance(mesh, Mesh) else formats.read_mesh(mesh)
    check_usable(surface, Path("the mesh" if isinstance(mesh, Mesh) else mesh))
    reference = _open_truth(truth, surface.origin)
    if reference.diagonal == 0.0:
        raise InputError("all of the truth is at one place", "give a truth with an extent")
    return Comparison(measure_mesh(surface, reference, samples, seed, thresholds))


def _open_truth(
    truth: Mesh | PointCloud | ArrayLike | str | PathLike[str], origin: FloatArray
) -> Truth:
    """Return the truth in the frame of the mesh."""
    if isinstance(truth, str | PathLike):
        return open_truth(fspath(truth), origin)
    if isinstance(truth, Mesh):
        mesh: plain.Mesh = unwrap_mesh(truth)
        check_usable(mesh, Path("the truth"))
        return MeshTruth(
            replace(mesh, vertices=mesh.vertices + (mesh.origin - origin), origin=origin)
        )
    cloud = check_cloud(truth, None, "truth")
    return PointTruth(replace(cloud, positions=cloud.positions + (cloud.origin - origin)))


def compare_epochs(
    new: Mesh | PointCloud | ArrayLike | str | PathLike[str],
    old: Mesh | PointCloud | ArrayLike | str | PathLike[str],
    *,
    up: Literal["x", "y", "z"] = "z",
    cell: float | None = None,
    registration: float | None = None,
) -> Change | SolidChange:
    """Measure what changed between two epochs, as ``hpcapp compare --volume`` does.

    Of two closed meshes that is what they enclose (`SolidChange`); of all others, what was cut and
    filled of a terrain (`Change`).

    Parameters
    ----------
    new, old : Mesh, PointCloud, array_like of shape (n, 3), str or PathLike
        Two meshes, two clouds, or one of each; or the files of them.
    up : {"x", "y", "z"}
        The axis that points up.
    cell : float, optional
        Width of a cell of terrain, seen from above; by default as the sparser epoch needs.
    registration : float, optional
        Standard deviation of the shift between both; by default the shift where nothing changed.

    Raises
    ------
    InputError
        They have hardly any ground in common, or only one of them is closed.
    UsageError
        Another argument is out of its range or does not fit, or a suffix is unknown.

    Examples
    --------
    >>> import hpcapp, numpy as np
    >>> ground = np.random.default_rng(0).random((20000, 3)) * [10, 10, 0.01]
    >>> higher = ground + np.outer(np.hypot(*(ground[:, :2] - 5).T) < 2, [0, 0, 1])
    >>> change = hpcapp.compare_epochs(higher, ground)
    >>> abs(change.fill.volume - 4 * np.pi) < change.fill.uncertainty
    True
    """
    if up not in ("x", "y", "z"):
        raise UsageError(f"up is {up!r}", "choose 'x', 'y' or 'z'")
    if cell is not None:
        check_range("cell", cell, 0.0, is_open=True)
    if registration is not None:
        check_range("registration", registration, 0.0)
    epochs = take_epoch(new, "new"), take_epoch(old, "old")
    return measure_epochs(*epochs, up, cell, registration).change


def measure_heaps(
    scan: Mesh | PointCloud | ArrayLike | str | PathLike[str],
    polygons: str | PathLike[str],
    *,
    above: str | float = "rim",
    cell: float | None = None,
    registration: float | None = None,
) -> list[Heap]:
    """Measure heaps above the ground round them, as ``hpcapp compare --volume --above`` does.

    Parameters
    ----------
    scan : Mesh, PointCloud, array_like of shape (n, 3), str or PathLike
        A mesh or points, z up; or the file of them.
    polygons : str or PathLike
        The file of the toes of the heaps, or WKT.
    above : str or float
        The base: ``"rim"``, what the ground round each is continued to; ``"plane"``, the plane
        through it; or a height.
    cell : float, optional
        Width of a cell, seen from above; by default as the points need.
    registration : float, optional
        Standard deviation of the place of a polygon against its heap; by default it is widened as
        long as the heap goes on.

    Raises
    ------
    InputError
        There are too few points in a polygon, or hardly any round it.
    UsageError
        Another argument is out of its range.
    MissingLibraryError
        shapely is not installed.

    Examples
    --------
    >>> import hpcapp, numpy as np
    >>> points = np.random.default_rng(0).random((20000, 3)) * [20.0, 20.0, 0.0]
    >>> away = np.linalg.norm(points[:, :2] - 10.0, axis=1)
    >>> points[:, 2] = np.maximum(3.0 - 0.5 * away, 0.0)  # a cone of 113
    >>> heap, = hpcapp.measure_heaps(points, "POLYGON ((3 3, 17 3, 17 17, 3 17, 3 3))")
    >>> abs(heap.volume - 36.0 * np.pi) < heap.uncertainty < 1.0
    True
    """
    for name, value in (("cell", cell), ("registration", registration)):
        if value is not None:
            check_range(name, value, 0.0, is_open=name == "cell")
    drawn = read_polygons(fspath(polygons))
    return heap.measure_heaps(take_epoch(scan, "scan"), drawn, above, cell, registration)


def take_epoch(epoch: Mesh | PointCloud | ArrayLike | str | PathLike[str], name: str) -> Epoch:
    """Return one scan of a place: read, or checked."""
    if isinstance(epoch, str | PathLike):
        return open_epoch(fspath(epoch))
    if isinstance(epoch, Mesh):
        check_usable(mesh := unwrap_mesh(epoch), Path(name))
        return Epoch(name, mesh)
    return Epoch(name, check_cloud(epoch, None, name))
