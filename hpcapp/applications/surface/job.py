"""One reconstruction job from file to file: what ``hpcapp reconstruct`` runs.

::

    file ─> cloud in memory ──────────────┐
      └───> cloud in a folder (workers) ──┴─> pipeline ─> surface in parts ─> file
"""

from __future__ import annotations

import logging
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpcapp.applications.surface.doubts import (
    doubt_closure,
    doubt_normals,
    doubt_resolution,
    sample_cloud,
)
from hpcapp.applications.surface.hierarchical import TILE_POINTS
from hpcapp.applications.surface.keeping import Keeping, digest
from hpcapp.applications.surface.loading import Loaded, load_folder, load_memory
from hpcapp.applications.surface.memory import check_memory, fits_memory, fitting_tile
from hpcapp.applications.surface.output import open_output
from hpcapp.applications.surface.pipeline import Reconstruction
from hpcapp.applications.surface.pipeline import reconstruct as run_pipeline
from hpcapp.applications.surface.settings import (
    Settings,
    choose_backend,
    choose_grid,
    choose_method,
    choose_steps,
    choose_threads,
)
from hpcapp.applications.surface.topology import Topology
from hpcapp.backends import BACKENDS, Backend, open_executor
from hpcapp.progress import Progress, StageClock
from hpccomponent.errors import InputError, UsageError
from hpccomponent.surface.arranged_cloud import ArrangedCloud
from hpccomponent.surface.build import kernel_id
from hpccomponent.surface.points import PointCloud, bounding_box

__all__ = ["Settings", "run_job", "warn"]

log = logging.getLogger("hpcapp")


def run_job(settings: Settings, progress: Progress) -> dict[str, Any]:
    """Reconstruct a mesh from file to file.

    Parameters
    ----------
    settings : Settings
        What the user asked for.
    progress : Progress
        Where stages are announced.

    Returns
    -------
    dict
        The job's report: JSON values; its keys are in ``docs/reconstruct.md``.

    Raises
    ------
    HpcError
        Whatever went wrong; no output is left half written.
    """
    clock = StageClock(progress)
    with open_output(settings.output, settings.points) as target, _open_room(settings) as room:
        run = _run_in_memory if room.folder is None else _run_in_folder
        report, surface = run(settings, room, clock)
        with clock.stage("write"):
            surface.write(target)
    report["stages"] = {name: round(seconds, 6) for name, seconds in clock.seconds.items()}
    return report


@dataclass(frozen=True, slots=True, eq=False)
class _Room:
    """Where a job has its points and tiles besides memory.

    Parameters
    ----------
    keeping : Keeping or None
        Where finished tiles are kept.
    folder : Path or None
        Where the points lie; None where they are in memory.
    """

    keeping: Keeping | None
    folder: Path | None


@contextmanager
def _open_room(settings: Settings) -> Iterator[_Room]:
    """Find room for a job; what it keeps is taken away when it has been done."""
    if settings.resume and settings.temp_dir is None:
        raise UsageError("--resume goes on from what lies in --temp-dir", "give that too")
    in_memory = settings.method == "paper" or fits_memory(settings.points, settings.max_memory)
    if settings.method == "paper" or (in_memory and settings.temp_dir is None):
        yield _Room(None, None)
        return
    job, place = _name_job(settings), settings.temp_dir
    if place is None or "://" in place:
        is_shared = place is not None or choose_backend(settings, TILE_POINTS) in BACKENDS
        with tempfile.TemporaryDirectory(prefix="hpcapp-") as room:
            keeping = Keeping(place or room, job, settings.resume, is_shared)
            keeping.check()
            yield _Room(keeping, None if in_memory else Path(room) / job / "points")
            keeping.clear()
        return
    folder = Path(place.removeprefix("folder:")).resolve()
    keeping = Keeping(str(folder), job, settings.resume)
    keeping.check()
    yield _Room(keeping, None if in_memory else folder / job / "points")
    keeping.clear()
    shutil.rmtree(folder / job, ignore_errors=True)


def _name_job(settings: Settings) -> str:
    """Return a hash of the input, of what decides the mesh, and of the kernels."""
    try:
        found = settings.points.stat()
    except OSError as error:
        raise InputError(
            f"{settings.points}: cannot be read: {error.strerror}", "check the file's name"
        ) from error
    return digest(
        str(settings.points.resolve()), found.st_size, found.st_mtime_ns, settings.grid,
        settings.depth, settings.voxel_size, settings.clean, settings.smoothness,
        settings.detail, settings.outliers, settings.denoise, settings.resample, kernel_id(),
    )  # fmt: skip


def _run_in_memory(
    settings: Settings, room: _Room, clock: StageClock
) -> tuple[dict[str, Any], Any]:
    """Run a job whose points are in memory."""
    loaded = load_memory(settings, clock)
    loaded.report(settings.points)
    cloud = loaded.cloud
    assert isinstance(cloud, PointCloud)  # noqa: S101 - it is the one in memory
    grid = choose_grid(settings, *bounding_box(cloud.positions))
    check_memory(settings.method, grid, cloud)
    name = choose_backend(settings, len(cloud))
    with open_executor(name, workers=settings.workers, policy=settings.policy) as backend:
        return _reconstruct(settings, room, loaded, grid, backend, clock)


def _run_in_folder(
    settings: Settings, room: _Room, clock: StageClock
) -> tuple[dict[str, Any], Any]:
    """Run a job whose points are in a folder."""
    assert room.folder is not None  # noqa: S101 - or this would not be called
    log.info("the points are put into %s", room.folder)
    name = choose_backend(settings, TILE_POINTS)
    with open_executor(name, workers=settings.workers, policy=settings.policy) as backend:
        points = _choose_tile(settings, backend) or TILE_POINTS
        loaded = load_folder(settings, room.folder, points, backend.workforce, clock)
        loaded.report(settings.points)
        assert not isinstance(loaded.cloud, PointCloud)  # noqa: S101 - it is the one on disk
        grid = choose_grid(settings, loaded.cloud.low, loaded.cloud.high)
        return _reconstruct(settings, room, loaded, grid, backend, clock)


def _reconstruct(
    settings: Settings,
    room: _Room,
    loaded: Loaded,
    grid: int,
    backend: Backend,
    clock: StageClock,
) -> tuple[dict[str, Any], Any]:
    """Run the pipeline, and describe what came of it."""
    workforce, cloud = backend.workforce, loaded.cloud
    tile_points = _choose_tile(settings, backend)
    method = choose_method(settings, grid, choose_threads(len(cloud)), tile_points, room.keeping)
    log.info(
        "method %s, grid %d, backend %s, workers %d, policy %s, kernels %s",
        method.name, grid, backend.name, workforce.workers, settings.policy, kernel_id(),
    )  # fmt: skip
    result = run_pipeline(cloud, method, workforce, clock, choose_steps(settings))
    report = _describe(settings, grid, result, backend)
    report["warnings"] = warn(settings, grid, cloud, result)
    report["dropped"] = {
        "non_finite_points": loaded.dropped.non_finite_points,
        "bad_normals": loaded.dropped.bad_normals,
        "outliers": loaded.cleaned.outliers,
    }
    report["turned_normals"] = loaded.cleaned.flipped
    return report, result.surface


def _choose_tile(settings: Settings, backend: Backend) -> int | None:
    """Return how many points a tile may have so that a process keeps to its memory."""
    if settings.max_memory is None:
        return None
    workforce = backend.workforce
    return fitting_tile(settings.max_memory, workforce.workers if workforce.in_process else 1)


def warn(
    settings: Settings, grid: int, cloud: PointCloud | ArrangedCloud, result: Reconstruction
) -> list[str]:
    """Log what should make the user doubt the mesh, and return it for the report.

    Parameters
    ----------
    settings : Settings
    grid : int
        Cells along the longest side.
    cloud : PointCloud or ArrangedCloud
    result : Reconstruction
    """
    if isinstance(cloud, PointCloud):
        low, high = bounding_box(cloud.positions)
    else:
        low, high, cloud = cloud.low, cloud.high, sample_cloud(cloud)
    step = float((high - low).max()) / grid
    doubts = doubt_resolution(cloud, step)  # explains all that the others would find
    if not doubts:
        doubts = doubt_normals(cloud)
        if settings.method != "paper":  # which leaves sheets in its boxes wherever a patch ends
            doubts += doubt_closure(low, high, result.surface, step)
    for doubt in doubts:
        log.warning("warning: %s", doubt)
    return doubts


def _summarize(topology: Topology) -> str:
    """Say in one line what the mesh is, for people."""
    closed = "watertight" if topology.watertight else "not watertight"
    return (
        f"{topology.vertices} vertices, {topology.faces} faces, {closed}, "
        f"{topology.components} component(s)"
    )


def _describe(
    settings: Settings, grid: int, result: Reconstruction, backend: Backend
) -> dict[str, Any]:
    traffic = backend.traffic()
    topology = result.topology
    return {
        "summary": _summarize(topology),
        "method": settings.method,
        "kernels": kernel_id(),
        "points": result.points,
        **result.facts,
        "grid": grid,
        "vertices": topology.vertices,
        "faces": topology.faces,
        "watertight": topology.watertight,
        "edge_manifold": topology.edge_manifold,
        "vertex_manifold": topology.vertex_manifold,
        "components": topology.components,
        "genus": topology.genus,
        "backend": backend.name,
        "workers": backend.workforce.workers,
        "policy": settings.policy,
        "bytes_sent": traffic.bytes_sent,
        "bytes_received": traffic.bytes_received,
    }
