"""Surface reconstruction from Python: arrays in, a mesh out, by the command's own steps.

::

    points, normals ── check ─> PointCloud ── the job's steps ─> Mesh in the points' coordinates

Users call it as ``hpcapp.reconstruct``.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hpcapp.applications.surface.attributes.choice import parse_attributes
from hpcapp.applications.surface.attributes.labels import find_labels
from hpcapp.applications.surface.job.backend_choice import approach_workers
from hpcapp.applications.surface.job.carry import carry_columns
from hpcapp.applications.surface.job.load import arrange_points, prepare, told_sensor
from hpcapp.applications.surface.job.steps import run_steps
from hpcapp.applications.surface.method import MAX_GRID, MIN_GRID, MethodSettings
from hpcapp.applications.surface.methods import DEFAULT_METHOD, find_method
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.options import option_names
from hpcapp.applications.surface.settings import Settings
from hpcapp.applications.surface.types.mesh import Mesh as TriangleMesh
from hpcapp.applications.surface.types.points import ByteArray, FloatArray, PointCloud
from hpcapp.applications.surface.viewpoint import Viewpoint, parse_viewpoint
from hpcapp.communicator.scheduling.verification import Verification, attempt, repeat_until_trusted
from hpcapp.io import drop_unusable
from hpcapp.io.frame import to_local
from hpcapp.io.points.survey import is_flown_over
from hpcapp.io.points.usable import Dropped, refuse_too_few
from hpcapp.pages.shown_mesh import Mesh
from hpcapp.progress import Progress, ProgressObserver, StageClock
from hpccomponent.errors import InputError, UsageError

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["reconstruct"]

log = logging.getLogger("hpcapp")

Report = Callable[[str, int, int], object]


def reconstruct(
    points: ArrayLike | PointCloud,
    normals: ArrayLike | None = None,
    grid: int | None = None,
    *,
    voxel_size: float | None = None,
    method: str | MethodSettings = DEFAULT_METHOD,
    smoothness: float | None = None,
    detail: float | None = None,
    clean: bool | None = None,
    close: str | None = None,
    trim: str | None = None,
    fill_holes: str | None = None,
    uniform: bool | None = None,
    viewpoint: str | ArrayLike | None = None,
    attributes: str = "auto",
    faces: int | None = None,
    tolerance: float | None = None,
    executor: str | Executor | Client | None = None,
    workers: int | None = None,
    verify: float | None = None,
    progress: Report | None = None,
) -> Mesh:
    """Turn points into a mesh, the one that ``hpcapp reconstruct`` writes.

    Parameters
    ----------
    points : array_like, shape (n, 3), or PointCloud
        Coordinates in any unit and any frame, georeferenced ones too. A cloud brings its normals,
        and the colours and attributes that the mesh is to carry.
    normals : array_like, shape (n, 3), optional
        Pointing out of the object, of any length but zero; not beside a cloud. Estimated where
        there are none.
    grid : int, optional
        Cells along the longest side, 16 to 4096; by default what the points resolve.
    voxel_size : float, optional
        Edge of a cell in the unit of the points; takes the place of `grid`.
    method : str, Hierarchical or Paper
        ``hierarchical``, ``paper``, or a method with its options: ``hpcapp.Paper(delta=0.2)``.
    smoothness, detail, clean, close, trim, fill_holes, uniform : float, bool and str, optional
        Options of the default method, where `method` is a name; see `hpcapp.Hierarchical`.
    viewpoint : str or array_like, shape (3,) or (s, 3), optional
        Where the points were measured from, where they have no normals: ``above``, ``below``,
        ``inside``, the places of the sensor in the coordinates of `points`, or the name of a file
        with its trajectory.
    attributes : str
        What the mesh's vertices carry: ``auto`` (all that the cloud has), ``none``, or names with
        commas between them, of which ``normals`` and ``support`` are made for the vertices.
    faces : int, optional
        Simplify the mesh to so many triangles.
    tolerance : float, optional
        Simplify the mesh while its surface moves by less than this length.
    executor : str, concurrent.futures.Executor or distributed.Client, optional
        Where batches run: a name that ``--backend`` takes or the file of a cluster, or what is
        open already and stays so; by default what pays for so many points.
    workers : int, optional
        How many tasks run at once, where the executor leaves that open.
    verify : float, optional
        The share of the tasks that run again on another machine, from 0 to 1; by default 0.02 on
        a cluster with three workers or more.
    progress : callable, optional
        Told (stage, parts done, parts in all) as the work proceeds, in the calling thread; what it
        raises ends the job.

    Returns
    -------
    Mesh
        Vertices in the coordinates of `points`, float64 (``origin`` is zero), with their normals,
        colours and attributes; faces anticlockwise as seen from outside. What is to be doubted in
        it is logged as a warning.

    Raises
    ------
    InputError
        `points` or `normals` is not such an array, holds NaN or infinity, or shows no surface.
    UsageError
        Another argument is out of its range.
    JobError
        The work could not be finished.

    Examples
    --------
    >>> normals = np.random.default_rng(0).normal(size=(2000, 3))
    >>> normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    >>> mesh = reconstruct(7.0 + 2.0 * normals, normals, grid=32)
    >>> float(np.abs(np.linalg.norm(mesh.vertices - 7.0, axis=1) - 2.0).max()) < 0.1
    True
    """
    options = {
        "smoothness": smoothness,
        "detail": detail,
        "clean": clean,
        "close": close,
        "trim": trim,
        "fill_holes": fill_holes,
        "uniform": uniform,
    }
    settings = Settings(
        method=_choose_method(method, options),
        grid=grid,
        voxel_size=voxel_size,
        backend=executor if isinstance(executor, str) else "auto",
        workers=workers,
        verify=verify,
        attributes=parse_attributes(attributes),
        viewpoint=_choose_viewpoint(viewpoint),
        faces=faces,
        tolerance=tolerance,
    )
    _check_settings(settings)
    checked = settings.attributes.select(_check_cloud(points, normals), "the cloud")
    labels = find_labels(checked.attributes)
    reporter = _Reporter(progress or (lambda *_: None))
    clock = StageClock(Progress(reporter))
    given = None if isinstance(executor, str) else executor
    verification = _choose_verification(given, verify)
    with approach_workers(settings, verification=verification) as opener:
        sensor = _find_sensor(settings, checked)
        read = replace(arrange_points(settings, checked, labels, clock), sensor=sensor)
        del checked  # makes room
        refuse_too_few(len(read.cloud_pass.cloud), Dropped(0, 0), "points")
        loaded = prepare(settings, read, clock)
        del read
        for warning in loaded.oriented.warnings:
            log.warning("warning: %s", warning)

        def run(_is_first: bool) -> TriangleMesh:
            with (
                attempt(verification, lambda error: error is reporter.raised),
                run_steps(settings, loaded, opener, clock, executor=given) as outcome,
            ):
                carrying = carry_columns(settings, loaded, outcome, clock)
                return outcome.result.surface.mesh(carrying)

        mesh = repeat_until_trusted(verification, run)
    return Mesh.of(replace(mesh, vertices=mesh.vertices + mesh.origin, origin=np.zeros(3)))


def _choose_verification(given: object, verify: float | None) -> Verification:
    """Return what a job finds out about machines: where an Executor is lent, it belongs to that."""
    own: Verification | None = getattr(given, "verification", None)
    if own is None:
        if given is not None and verify:
            raise UsageError(
                f"a {type(given).__name__} does not say which machine gives an answer",
                "leave verify out, or give the file of a cluster or 'zmq'",
            )
        return Verification(verify)
    if verify is not None:
        own.share = verify
    return own


class _Reporter(ProgressObserver):
    """Calls a function with the stage and how far it has come, from none to all of its parts."""

    def __init__(self, report: Report) -> None:
        self.raised: Exception | None = None
        self._call = report
        self._done, self._total = 0, 1

    def _report(self, stage: str, done: int, total: int) -> None:
        self._done, self._total = done, total
        try:
            self._call(stage, done, total)
        except Exception as error:
            self.raised = error
            raise

    def on_begin(self, stage: str) -> None:
        """Report that nothing of the stage is done."""
        self._report(stage, 0, 1)

    def on_advance(self, stage: str, done: int, total: int) -> None:
        """Report how far the stage has come."""
        self._report(stage, done, total)

    def on_end(self, stage: str, seconds: float) -> None:
        """Report that all of the stage is done, unless that was said."""
        del seconds
        if self._done < self._total:
            self._report(stage, self._total, self._total)


def _choose_method(method: str | MethodSettings, options: dict[str, Any]) -> MethodSettings:
    """Return the method with the options that were given beside it."""
    given = {name: value for name, value in options.items() if value is not None}
    if isinstance(method, str):
        kind = find_method(method)
        for name in given.keys() - set(option_names(kind)):
            raise UsageError(f"{name} means nothing to the method {method!r}", "leave it out")
        return kind(**given)
    if given:
        raise UsageError(
            f"method and {', '.join(given)} exclude each other",
            f"give {next(iter(given))} to {type(method).__name__}",
        )
    return method


def _choose_viewpoint(viewpoint: str | ArrayLike | None) -> Viewpoint:
    """Return where the points were measured from, as the command would."""
    if isinstance(viewpoint, str):
        return parse_viewpoint([viewpoint])
    if viewpoint is None:
        return ()
    places = _check_rows("viewpoint", np.atleast_2d(np.asarray(viewpoint)))
    return tuple((x, y, z) for x, y, z in places.tolist())


def _find_sensor(settings: Settings, points: PointCloud) -> Sensor:
    """Return where the points were measured from: as the user says, else as they look."""
    if settings.viewpoint or not is_flown_over(points):
        return told_sensor(settings.viewpoint)
    return Sensor("above")


def _check_settings(settings: Settings) -> None:
    """Refuse what the command would refuse."""
    settings.target.check()
    _check_range("verify", settings.verify or 0.0, 0.0, 1.0)
    if settings.grid is not None:
        if not isinstance(settings.grid, int | np.integer):
            raise UsageError(f"grid is {settings.grid!r}", "give a whole number of cells")
        _check_range("grid", settings.grid, MIN_GRID, MAX_GRID)
    if settings.voxel_size is None:
        return
    if settings.grid is not None:
        raise UsageError("grid and voxel_size exclude each other", "give one of them")
    if not settings.voxel_size > 0.0:
        raise UsageError(f"voxel_size is {settings.voxel_size!r}", "give an edge longer than zero")


def _check_range(name: str, value: Any, low: float, high: float) -> None:
    if not low <= value <= high:
        raise UsageError(f"{name} is {value!r}", f"give a number from {low:g} to {high:g}")


def _check_cloud(points: ArrayLike | PointCloud, normals: ArrayLike | None) -> PointCloud:
    """Return the arrays as a cloud in its local frame; InputError names the argument at fault."""
    if isinstance(points, PointCloud):
        if normals is not None:
            raise UsageError("normals stands beside a cloud", "give the cloud its normals")
        given = points
    else:
        given = PointCloud(_check_rows("points", points), _check_normals(normals))
    positions, directions = _check_rows("points", given.positions), _check_normals(given.normals)
    if directions is not None and len(positions) != len(directions):
        raise InputError(
            f"points has {len(positions)} rows and normals {len(directions)}",
            "give one normal for each point",
        )
    colours = None if given.colours is None else _check_colours(given.colours, len(positions))
    attributes = {
        name: _check_column(name, column, len(positions))
        for name, column in given.attributes.items()
    }
    local, origin = (positions, given.origin) if given.origin.any() else to_local(positions)
    whole = PointCloud(local, directions, colours, attributes, origin)
    cloud, dropped = drop_unusable(whole, "points")
    if dropped.total:
        raise InputError(
            f"normals has {dropped.total} of {len(positions)} rows of length zero",
            "leave those points out",
        )
    return cloud


def _check_normals(normals: ArrayLike | None) -> FloatArray | None:
    return None if normals is None else _check_rows("normals", normals)


def _check_colours(values: ArrayLike, points: int) -> ByteArray:
    """Return colours as bytes, where they are those of so many points."""
    array = np.asarray(values)
    if array.shape != (points, 3):
        raise InputError(
            f"colours has the shape {array.shape}, not ({points}, 3)",
            "give red, green and blue of each point",
        )
    if array.dtype.kind not in "iu" or (points and not 0 <= array.min() <= array.max() <= 255):
        raise InputError(
            f"colours holds {array.dtype} beyond whole numbers from 0 to 255",
            "scale them to 0 to 255, as uint8",
        )
    return np.ascontiguousarray(array, dtype=np.uint8)


def _check_column(name: str, values: ArrayLike, points: int) -> NDArray[Any]:
    """Return an attribute as an array, where it has a number for each of so many points."""
    array = np.asarray(values)
    if array.shape != (points,) or array.dtype.kind not in "biuf":
        raise InputError(
            f"the attribute {name!r} holds {array.dtype} of the shape {array.shape}",
            f"give numbers, one for each of the {points} points",
        )
    return array


def _check_rows(name: str, values: ArrayLike) -> FloatArray:
    """Return `values` as rows of three finite numbers, float64."""
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"{name} is no array ({error})", "give rows of three numbers") from None
    if array.dtype.kind not in "biuf":
        raise InputError(
            f"{name} holds {array.dtype}, not numbers", "give rows of three numbers, for instance "
            "a float64 array of shape (n, 3)"
        )  # fmt: skip
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(
            f"{name} has the shape {array.shape}, not (n, 3)", "give one row of three per point"
        )
    finite = np.logical_and.reduce([np.isfinite(column) for column in array.T])
    if not finite.all():
        raise InputError(
            f"{name} has {int((~finite).sum())} of {len(array)} rows with NaN or infinity, first "
            f"{name}[{int(np.argmin(finite))}]",
            "leave those points out",
        )
    return np.ascontiguousarray(array, dtype=np.float64)
