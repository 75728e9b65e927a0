"""Surface reconstruction from Python: files or arrays in, a mesh out, by the command's own steps.

::

    files ───────────────────────┐
    points, normals ── check ────┴─> Loaded ── the job's steps ─> Mesh in the points' coordinates

Users call it as ``hpcapp.reconstruct``.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, nullcontext
from dataclasses import fields, replace
from functools import partial
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from hpcapp.alignment.place import choose_place
from hpcapp.api.arrays import check_cloud, check_rows
from hpcapp.api.mesh import Mesh, wrap_mesh
from hpcapp.api.mesh_page import JobRecord
from hpcapp.applications.surface.attributes.choice import parse_attributes
from hpcapp.applications.surface.attributes.labels import find_labels
from hpcapp.applications.surface.cli.run import load_stored
from hpcapp.applications.surface.cloud.frame import Frame
from hpcapp.applications.surface.job.backend_choice import approach_workers
from hpcapp.applications.surface.job.outcome import Outcome
from hpcapp.applications.surface.job.plan import plan_job
from hpcapp.applications.surface.job.scan import Loaded
from hpcapp.applications.surface.job.settings import JobSettings, Settings
from hpcapp.applications.surface.job.site import open_site
from hpcapp.applications.surface.job.source import MARGIN
from hpcapp.applications.surface.job.storage import JobStorage, open_storage
from hpcapp.applications.surface.methods.method import MethodSettings
from hpcapp.applications.surface.methods.options import option_names
from hpcapp.applications.surface.methods.table import DEFAULT_METHOD, find_method
from hpcapp.applications.surface.normals.sensor import Sensor, sensor_of
from hpcapp.applications.surface.normals.viewpoint import Viewpoint, parse_viewpoint
from hpcapp.applications.surface.pipeline import prepare, reconstruct_cloud
from hpcapp.applications.surface.resolution.memory import parse_limit
from hpcapp.applications.surface.steps.carry import carry_columns
from hpcapp.applications.surface.steps.read import arrange_points
from hpcapp.applications.surface.steps.report import describe_outcome
from hpcapp.cancellation import Cancellation
from hpcapp.communicator.scheduling.policy import DEFAULT_POLICY
from hpcapp.communicator.scheduling.verification import Verification, attempt, repeat_until_trusted
from hpcapp.geometry.points import PointCloud
from hpcapp.geometry.validity import Dropped
from hpcapp.io import read_whole
from hpcapp.io.crs import UNKNOWN
from hpcapp.io.frame import finite_bounds
from hpcapp.io.geocentric import find_upright
from hpcapp.io.points.inputs import find_paths, gather_points
from hpcapp.io.points.mesh_points import slice_cloud
from hpcapp.io.points.survey import is_flown_over
from hpcapp.io.points.usable import refuse_too_few
from hpcapp.parts.crop import Crop, make_crop
from hpcapp.progress import Progress, ProgressObserver, StageClock
from hpccomponent.errors import UsageError
from hpccomponent.ranges import FARTHEST, check_range, is_place

if TYPE_CHECKING:
    from distributed import Client


log = logging.getLogger("hpcapp")

OnProgress = Callable[[str, int, int], object]
PathName: TypeAlias = str | PathLike[str]
_NORMALS = ("auto", "file", "estimate")


def reconstruct(
    points: PathName | Sequence[PathName] | PointCloud | ArrayLike,
    normals: str | ArrayLike | None = "auto",
    grid: int | None = None,
    *,
    sample: int | None = None,
    box: Sequence[float] | None = None,
    around: Sequence[float] | None = None,
    polygon: str | PathLike[str] | None = None,
    classes: Sequence[int] | None = None,
    not_classes: Sequence[int] | None = None,
    ground: bool = False,
    voxel_size: float | None = None,
    method: str | MethodSettings = DEFAULT_METHOD,
    smoothness: float | None = None,
    detail: float | None = None,
    clean: bool | None = None,
    close: str | None = None,
    trim: str | None = None,
    fill_holes: str | None = None,
    uniform: bool | None = None,
    viewpoints: str | ArrayLike | None = None,
    align: bool = False,
    outliers: bool = False,
    denoise: bool = False,
    resample: bool = False,
    attributes: str = "auto",
    faces: int | None = None,
    tolerance: float | None = None,
    pieces: int | None = None,
    smallest: float | None = None,
    executor: str | Executor | Client | None = None,
    workers: int | None = None,
    policy: str = DEFAULT_POLICY,
    verify: float | None = None,
    max_memory: str | float | None = None,
    temp_dir: PathName | None = None,
    update: PathName | None = None,
    resume: bool = False,
    on_progress: OnProgress | None = None,
    cancel: Cancellation | None = None,
) -> Mesh:
    """Turn points into a mesh, the one that ``hpcapp reconstruct`` writes.

    Parameters
    ----------
    points : str, PathLike, sequence of these, PointCloud, or array_like of shape (n, 3)
        Files, or patterns as ``scans/*.laz``; a cloud, which brings its normals, and the colours
        and attributes that the mesh is to carry; one of Open3D or trimesh, likewise; or
        coordinates in any unit and any frame.
    normals : str or array_like of shape (n, 3)
        ``auto`` estimates those that are missing and mends those that contradict each other,
        ``file`` takes those of the files or the cloud as they are, ``estimate`` takes none of them.
        Or beside an array of points, their normals: pointing out of the object, of any length.
    grid : int, optional
        Cells along the longest side, 16 to 4096; by default what the points resolve.
    sample : int, optional
        The files are meshes: so many points on the faces of each are taken; by default 100,000 of
        those whose vertices are too few.
    box : sequence of float, optional
        x, y and z of two corners: the mesh is what lies between them, in the coordinates of the
        points.
    around : sequence of float, optional
        x, y, z of a place and a distance from it, likewise.
    polygon : path-like or str, optional
        A file of polygons (GeoJSON, WKT or a shapefile), or WKT itself: the mesh is what lies
        above and below them.
    classes, not_classes : sequence of int, optional
        The classes of points that are taken, or that are left out: those of LAS, or of the
        attribute ``classification``.
    ground : bool
        Only the bare ground: class 2 of the points, or what a cloth simulation finds.
    voxel_size : float, optional
        Edge of a cell in the unit of the points; takes the place of `grid`.
    method : str, Hierarchical or Paper
        ``hierarchical``, ``paper``, or a method with its options: ``hpcapp.Paper(delta=0.2)``.
    smoothness, detail, clean, close, trim, fill_holes, uniform : float, bool and str, optional
        Options of the default method, where `method` is a name; see `hpcapp.Hierarchical`.
    viewpoints : str or array_like, shape (3,) or (s, 3), optional
        Where the points were measured from, where they have no normals: ``above``, ``below``,
        ``outside``, ``inside``, the places of the sensor in the coordinates of `points`, or the
        name of a file with its trajectory, or one of cameras.
    align : bool
        The files are scans in frames of their own: align them first.
    outliers, denoise, resample : bool
        Remove statistical outliers, project the points by moving least squares, resample them to
        even density, before all else.
    attributes : str
        What the mesh's vertices carry: ``auto`` (all that the points have), ``none``, or names with
        commas between them, of which ``normals`` and ``support`` are made for the vertices.
    faces : int, optional
        Simplify the mesh to so many triangles.
    tolerance : float, optional
        Simplify the mesh while its surface moves by less than this length.
    pieces : int, optional
        So many connected pieces of the mesh are kept, the largest ones.
    smallest : float, optional
        Only pieces of the mesh with this area or more are kept, in squared units of the points.
    executor : str, concurrent.futures.Executor or distributed.Client, optional
        Where batches run: a name that ``--backend`` takes or the file of a cluster, or what is
        open already and stays so; by default what pays for so many points.
    workers : int, optional
        How many tasks run at once, where the executor leaves that open.
    policy : str
        ``adaptive``, ``pull`` or ``equal``; see `hpcapp.open_executor`.
    verify : float, optional
        The share of the tasks that run again on another machine, from 0 to 1; by default 0.02 on
        a cluster with three workers or more.
    max_memory : str or float, optional
        Of all processes of a machine: ``"2G"``, or bytes. Files that need more lie in a folder
        meanwhile; the mesh itself is returned in memory.
    temp_dir : str or PathLike, optional
        Where points and finished tiles of files lie meanwhile, as with ``--temp-dir``.
    update : str or PathLike, optional
        Where a call with other files has left its tiles, and this one's are left: as ``--update``.
    resume : bool
        Whether to go on from what an earlier call has left in `temp_dir`, and to leave it there
        where this one fails.
    on_progress : callable, optional
        Told (stage, parts done, parts in all) as the work proceeds, in the calling thread; what it
        raises ends the job.
    cancel : Cancellation, optional
        Ends the job within about a second when another thread calls its ``cancel()``.

    Returns
    -------
    Mesh
        In the coordinates of `points`, with their colours and attributes. What is to be doubted in
        it is logged as a warning. It keeps the points, for `Mesh.report`.

    Raises
    ------
    InputError
        A file or an array cannot be used, or shows no surface.
    UsageError
        Another argument is out of its range.
    MissingLibraryError
        A file or another argument needs a package that is not installed.
    JobCancelledError
        `cancel` was called.
    JobError
        The work could not be finished.

    Examples
    --------
    >>> import hpcapp
    >>> import numpy as np
    >>> normals = np.random.default_rng(0).normal(size=(2000, 3))
    >>> normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    >>> mesh = hpcapp.reconstruct(7.0 + 2.0 * normals, normals, grid=32)
    >>> float(np.abs(np.linalg.norm(mesh.vertices - 7.0, axis=1) - 2.0).max()) < 0.1
    True
    """
    own = {
        "smoothness": smoothness,
        "detail": detail,
        "clean": clean,
        "close": close,
        "trim": trim,
        "fill_holes": fill_holes,
        "uniform": uniform,
    }
    settings = Settings(
        method=_choose_method(method, own),
        grid=grid,
        voxel_size=voxel_size,
        backend=executor if isinstance(executor, str) else "auto",
        workers=workers,
        policy=policy,
        verify=verify,
        align=align,
        outliers=outliers,
        denoise=denoise,
        resample=resample,
        attributes=parse_attributes(attributes),
        normals=_choose_normals(normals),
        viewpoint=_choose_viewpoint(viewpoints),
        faces=faces,
        tolerance=tolerance,
        max_memory=None if max_memory is None else parse_limit(str(max_memory)),
        temp_dir=None if temp_dir is None else fspath(temp_dir),
        update=None if update is None else fspath(update),
        resume=resume,
        crop=make_crop(box, around, polygon, classes, not_classes, ground),
        pieces=pieces,
        smallest=smallest,
    )
    settings = settings.for_ground()
    rows = None if isinstance(normals, str) else normals
    names = _find_names(points)
    if not names and sample is not None:
        raise UsageError("sample is for files", "leave it out")
    if not names and align:
        raise UsageError("align is for files", "leave it out")
    if sample is not None:
        check_range("sample", sample, 1)
    if not names and (temp_dir is not None or update is not None or resume):
        raise UsageError("temp_dir, resume and update are for files", "leave them out")
    if names and rows is not None:
        raise UsageError("normals stands beside files, which have their own", "leave it out")
    cancellation = cancel or Cancellation()
    reporter = _Reporter(on_progress or (lambda *_: None), cancellation)
    given = None if isinstance(executor, str) else executor
    if names:
        with cancellation.heeded(), _open_files(settings, names, sample) as (job, source):
            return _run_files(job, source, given, reporter)
    whole = check_cloud(cast(ArrayLike, points), rows)
    sensor = _find_sensor(settings, settings.attributes.select(whole, "the cloud"))
    cloud = settings.attributes.select(_crop(settings.crop, whole), "the cloud")
    del whole
    waiting = [cloud]
    del cloud  # one reference, which the loading gives up to make room
    with cancellation.heeded():
        return _run(
            settings, "Mesh", lambda clock: _load_cloud(settings, waiting.pop(), sensor, clock),
            given, reporter,
        )  # fmt: skip


def _find_names(points: object) -> list[str]:
    """Return the files that are named; none where the points themselves are given."""
    if isinstance(points, str | PathLike):
        return [fspath(points)]
    given = points if isinstance(points, list | tuple) else []
    names = [fspath(name) for name in given if isinstance(name, str | PathLike)]
    return names if len(names) == len(given) else []


@contextmanager
def _open_files(
    settings: Settings, names: Sequence[str], sample: int | None
) -> Iterator[tuple[JobSettings, str]]:
    """Yield a job that reads files, and what these are called."""
    asked = {one.name: getattr(settings, one.name) for one in fields(Settings)}
    crop = settings.crop
    choose = partial(crop.narrow, margin=MARGIN)
    with gather_points(
        names,
        sample,
        for_surface=True,
        keeps_noise=crop.keeps_noise,
        choose=choose,
        place=choose_place(settings.align),
    ) as path:
        job = JobSettings(points=path, output="", inputs=find_paths(names), **asked)
        yield job, Path(job.shown).name


def _load_cloud(settings: Settings, cloud: PointCloud, sensor: Sensor, clock: StageClock) -> Loaded:
    if settings.normals == "estimate":
        cloud = replace(cloud, normals=None)
    labels = find_labels(cloud.attributes)
    frame = Frame()
    read = replace(arrange_points(settings, cloud, labels, frame, clock), sensor=sensor)
    del cloud  # makes room
    refuse_too_few(len(read.cloud_pass.cloud), Dropped(0, 0), "points")
    loaded = prepare(settings, read, frame, clock)
    for warning in loaded.oriented.warnings:
        log.warning("warning: %s", warning)
    return loaded


def _crop(crop: Crop, cloud: PointCloud) -> PointCloud:
    """Return the points that are asked for, and those around them, as a file's would be."""
    if crop == Crop():
        return cloud
    whole = replace(cloud, positions=cloud.positions + cloud.origin, origin=np.zeros(3))
    return read_whole(crop.take(slice_cloud(Path("points"), "arrays", whole), MARGIN))


def _run_files(
    settings: JobSettings, source: str, executor: Executor | Client | None, reporter: _Reporter
) -> Mesh:
    """Run a job that reads files; without limit and room for them they lie in memory."""
    verification = _choose_verification(executor, settings.verify)
    plan = plan_job(settings, is_opened=executor is not None)

    def run(is_first: bool) -> Mesh:
        job = settings if is_first else replace(settings, resume=False)
        clock, in_memory = StageClock(Progress(reporter)), nullcontext(JobStorage(None, None))
        is_bounded = job.max_memory is not None or job.room is not None or job.resume
        with (
            open_storage(job, plan.place) if is_bounded else in_memory as storage,
            attempt(verification, lambda error: error is reporter.raised),
            approach_workers(job, verification=verification) as opener,
            load_stored(job, plan, storage, opener, clock, executor, reporter.cancellation) as (
                loaded, site,
            ),
            reconstruct_cloud(job, loaded, site, clock) as outcome,
        ):  # fmt: skip
            return _wrap(job, source, loaded, outcome, clock, {"input": loaded.described})

    return repeat_until_trusted(verification, run)


def _run(
    settings: Settings,
    source: str,
    load_points: Callable[[StageClock], Loaded],
    executor: Executor | Client | None,
    reporter: _Reporter,
) -> Mesh:
    """Run a job whose points are loaded by a function."""
    clock = StageClock(Progress(reporter))
    verification = _choose_verification(executor, settings.verify)
    with approach_workers(settings, verification=verification) as opener:
        loaded = load_points(clock)
        site = partial(
            open_site, len(loaded.cloud), opener, clock,
            executor=executor, cancellation=reporter.cancellation,
        )  # fmt: skip

        def run(_is_first: bool) -> Mesh:
            with (
                attempt(verification, lambda error: error is reporter.raised),
                reconstruct_cloud(settings, loaded, site, clock) as outcome,
            ):
                return _wrap(settings, source, loaded, outcome, clock, {})

        return repeat_until_trusted(verification, run)


def _wrap(
    settings: Settings,
    source: str,
    loaded: Loaded,
    outcome: Outcome,
    clock: StageClock,
    facts: dict[str, Any],
) -> Mesh:
    """Return what came of a job, with its report."""
    carrying = carry_columns(settings, loaded, outcome, clock)
    mesh = outcome.result.surface.mesh(carrying)
    topology = outcome.result.surface.check()
    report = describe_outcome(settings, loaded, outcome, topology, carrying) | facts
    report["stages"] = dict(clock.seconds)
    kept = loaded.cloud if loaded.cloud.is_here else None  # a folder of points goes with the job
    return wrap_mesh(mesh, JobRecord(source, kept, report), topology, carrying.crs, report["up"])


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
    """Calls a function with the stage and how far it has come, until somebody cancels."""

    def __init__(self, report: OnProgress, cancellation: Cancellation) -> None:
        self.raised: Exception | None = None
        self.cancellation = cancellation
        self._call = report
        self._done, self._total = 0, 1

    def _report(self, stage: str, done: int, total: int) -> None:
        self._done, self._total = done, total
        try:
            self.cancellation.check()
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


def _choose_normals(normals: object) -> str:
    """Return what is done with normals: as the command does, unless the user says."""
    if not isinstance(normals, str):
        return "auto"
    if normals not in _NORMALS:
        raise UsageError(f"normals is {normals!r}", f"choose {', '.join(_NORMALS)}, or give rows")
    return normals


def _choose_viewpoint(viewpoints: str | ArrayLike | None) -> Viewpoint:
    """Return where the points were measured from, as the command would."""
    if isinstance(viewpoints, str):
        return parse_viewpoint([viewpoints])
    if viewpoints is None:
        return ()
    places = check_rows("viewpoints", np.atleast_2d(np.asarray(viewpoints)))
    for place in places.tolist():
        if not is_place(*place):
            raise UsageError(f"viewpoints has {place}", f"give numbers up to {FARTHEST:.0e}")
    return tuple((x, y, z) for x, y, z in places.tolist())


def _find_sensor(settings: Settings, points: PointCloud) -> Sensor:
    """Return where the points were measured from: as the user says, else as they look."""
    low, high = finite_bounds(points.positions)
    upright = find_upright(low + points.origin, high + points.origin, UNKNOWN)
    if settings.viewpoint or not is_flown_over(points):
        return sensor_of(settings.viewpoint, upright)
    return Sensor("above", upright=upright)
