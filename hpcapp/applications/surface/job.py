"""One reconstruction job from file to file: what ``hpcapp reconstruct`` runs."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.applications.surface.cleaning import (
    Cleaned,
    arrange_points,
    clean_cloud,
    drop_far,
)
from hpcapp.applications.surface.doubts import doubt_closure, doubt_normals, doubt_resolution
from hpcapp.applications.surface.hierarchical import MARGIN, HierarchicalMethod
from hpcapp.applications.surface.memory import check_memory
from hpcapp.applications.surface.method import Method
from hpcapp.applications.surface.output import open_output
from hpcapp.applications.surface.pipeline import Preprocess, Reconstruction
from hpcapp.applications.surface.pipeline import reconstruct as run_pipeline
from hpcapp.applications.surface.topology import Topology
from hpcapp.backends import Backend, available_cores, open_executor
from hpcapp.io import drop_unusable, read_points
from hpcapp.io.usable import Dropped
from hpcapp.progress import Progress, StageClock
from hpccomponent.errors import UsageError
from hpccomponent.surface.build import kernel_id
from hpccomponent.surface.points import PointCloud, bounding_box

__all__ = ["Settings", "run_job"]

log = logging.getLogger("hpcapp")

DEFAULT_GRID = 256
MIN_GRID, MAX_GRID = 16, 4096
# Below this many points a second thread costs more than it brings.
THREADS_FROM_POINTS = 100_000


@dataclass(frozen=True, slots=True)
class Settings:
    """What a user typed; see ``hpcapp reconstruct --help`` for each.

    Parameters
    ----------
    points : Path
        The point cloud.
    output : str
        The mesh to write; ``-`` for standard output.
    grid, depth, voxel_size : int, int, float or None
        The resolution; at most one of the three. `voxel_size` in length units of the input.
    backend, workers, policy : str, int or None, str
        Where batches run.
    cluster : Path or None
        The inventory of a cluster, in place of the backend.
    """

    points: Path
    output: str
    method: str = "hierarchical"
    grid: int | None = None
    depth: int | None = None
    voxel_size: float | None = None
    backend: str = "auto"
    workers: int | None = None
    policy: str = "adaptive"
    cluster: Path | None = None
    clean: bool = True
    smoothness: float = 1.0
    detail: float = 1.0
    delta: float = 0.1
    max_points: int | None = None
    cone: str = "paper"
    patches: int | None = None
    norm: str = "consistent"
    outliers: bool = False
    denoise: bool = False
    resample: bool = False


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
    with open_output(settings.output, settings.points) as target:
        with clock.stage("read"):
            cloud, dropped = drop_unusable(read_points(settings.points), str(settings.points))
            usable = len(cloud)
            if settings.method != "paper":  # which cuts the cloud up by itself
                cloud = arrange_points(drop_far(cloud) if settings.clean else cloud)
        _report_dropped(settings.points, dropped)
        cloud, cleaned = _clean(settings, cloud, usable - len(cloud), clock)
        grid = _choose_grid(settings, cloud)
        check_memory(settings.method, grid, cloud)
        threads = available_cores() if len(cloud) >= THREADS_FROM_POINTS else 1
        method = _choose_method(settings, grid, threads)
        backend_name = _choose_backend(settings, cloud)
        with open_executor(
            backend_name, workers=settings.workers, policy=settings.policy
        ) as backend:
            log.info(
                "method %s, grid %d, backend %s, workers %d, policy %s, kernels %s",
                method.name, grid, backend.name, backend.workforce.workers, settings.policy,
                kernel_id(),
            )  # fmt: skip
            result = run_pipeline(cloud, method, backend.workforce, clock, _steps(settings))
            report = _describe(settings, grid, result, backend)
        report["warnings"] = _warn(settings, grid, cloud, result)
        with clock.stage("write"):
            result.surface.write(target)
    report["dropped"] = {
        "non_finite_points": dropped.non_finite_points,
        "bad_normals": dropped.bad_normals,
        "outliers": cleaned.outliers,
    }
    report["turned_normals"] = cleaned.flipped
    report["stages"] = {name: round(seconds, 6) for name, seconds in clock.seconds.items()}
    return report


def _warn(settings: Settings, grid: int, cloud: PointCloud, result: Reconstruction) -> list[str]:
    """Log what should make the user doubt the mesh, and return it for the report."""
    low, high = bounding_box(cloud.positions)
    step = float((high - low).max()) / grid
    doubts = doubt_resolution(cloud, step)  # explains all that the others would find
    if not doubts:
        doubts = doubt_normals(cloud)
        if settings.method != "paper":  # which leaves sheets in its boxes wherever a patch ends
            doubts += doubt_closure(cloud, result.surface, step)
    for doubt in doubts:
        log.warning("warning: %s", doubt)
    return doubts


def _clean(
    settings: Settings, cloud: PointCloud, far: int, clock: StageClock
) -> tuple[PointCloud, Cleaned]:
    """Drop outliers and turn wrong normals round, and say so; the paper's method takes all."""
    if settings.method == "paper" or not settings.clean:
        return cloud, Cleaned(0, 0)
    with clock.stage("clean"):
        cloud, cleaned = clean_cloud(cloud)
    cleaned = replace(cleaned, outliers=far + cleaned.outliers)
    if cleaned.outliers:
        log.warning("%s: dropped %d outliers", settings.points, cleaned.outliers)
    if cleaned.flipped:
        log.warning("%s: turned %d wrong normals round", settings.points, cleaned.flipped)
    return cloud, cleaned


def _report_dropped(path: Path, dropped: Dropped) -> None:
    if dropped.non_finite_points:
        log.warning("%s: dropped %d points that are NaN or Inf", path, dropped.non_finite_points)
    if dropped.bad_normals:
        log.warning("%s: dropped %d points whose normal is zero, NaN or Inf",
                    path, dropped.bad_normals)  # fmt: skip


def _choose_grid(settings: Settings, cloud: PointCloud) -> int:
    """Return the cells along the longest side that the user asked for in one of three ways."""
    if settings.depth is not None:
        return int(2**settings.depth)
    if settings.voxel_size is None:
        return settings.grid or DEFAULT_GRID
    low, high = bounding_box(cloud.positions)
    longest = float((high - low).max())
    margins = 2 * MARGIN if settings.method == "hierarchical" else 0  # inside its grid
    with np.errstate(over="ignore"):
        cells = float(np.ceil(np.float64(longest) / settings.voxel_size)) + margins
    if not MIN_GRID <= cells <= MAX_GRID:  # NaN is not, either
        raise UsageError(
            f"--voxel-size {settings.voxel_size:g} means {cells:g} cells along the longest side",
            f"choose one that gives {MIN_GRID} to {MAX_GRID}; the side is {longest:g} long",
        )
    return int(cells)


def _choose_method(settings: Settings, grid: int, threads: int) -> Method[Any, Any]:
    if settings.method == "hierarchical":
        return HierarchicalMethod(grid, settings.smoothness, settings.detail, threads)
    from hpcapp.applications.surface.paper import PaperMethod  # it stands on heavy modules

    return PaperMethod(
        delta=settings.delta,
        max_points=settings.max_points,
        cone=settings.cone,
        patches=settings.patches,
        norm=settings.norm,
        grid=grid,
    )


def _steps(settings: Settings) -> tuple[tuple[str, Preprocess], ...]:
    """Return the preprocessing steps that are switched on, in the paper's order."""
    if not (settings.outliers or settings.denoise or settings.resample):
        return ()  # what the steps stand on is heavy
    from hpcapp.applications.surface.preprocess import denoise, remove_outliers, resample

    wanted: tuple[tuple[bool, str, Preprocess], ...] = (
        (settings.outliers, "remove outliers", remove_outliers),
        (settings.denoise, "denoise", denoise),
        (settings.resample, "resample", resample),
    )
    return tuple((name, step) for is_wanted, name, step in wanted if is_wanted)


def _choose_backend(settings: Settings, cloud: PointCloud) -> str:
    """Return the backend: the user's, else processes for `--workers`, else what pays here."""
    if settings.cluster is not None:
        return str(settings.cluster)
    if settings.backend != "auto":
        return settings.backend
    if settings.workers is not None:
        return "zmq"
    enough = len(cloud) >= THREADS_FROM_POINTS and available_cores() > 1
    return "threads" if enough else "serial"


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
