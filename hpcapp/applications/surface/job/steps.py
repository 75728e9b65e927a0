"""The steps from a loaded cloud to its surface: the same for files and for arrays."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hpcapp.applications.surface.checkpoint import Keeping
from hpcapp.applications.surface.input.folder import all_see_folder, choose_tile
from hpcapp.applications.surface.input.load import Loaded
from hpcapp.applications.surface.job.backend_choice import Choice, Job, Opener
from hpcapp.applications.surface.job.diagnostics import (
    SAMPLE,
    doubt_closure,
    doubt_normals,
    doubt_resolution,
    doubt_sides,
)
from hpcapp.applications.surface.job.resolution import find_grid
from hpcapp.applications.surface.method import Resources
from hpcapp.applications.surface.pipeline import Reconstruction
from hpcapp.applications.surface.pipeline import reconstruct as run_pipeline
from hpcapp.applications.surface.settings import (
    Settings,
    choose_steps,
    choose_threads,
)
from hpcapp.applications.surface.surface import simplify_surface
from hpcapp.backends.selection import Backend
from hpcapp.progress import StageClock
from hpccomponent.runtime.background import Deferred
from hpccomponent.surface.build import kernel_id
from hpccomponent.surface.cloud.arranged import ArrangedCloud
from hpccomponent.surface.types.points import FloatArray

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Outcome", "run_loaded", "run_memory"]

log = logging.getLogger("hpcapp")


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What came of a job, while its backend is open.

    Parameters
    ----------
    result : Reconstruction
    grid : int
        Cells along the longest side.
    backend : Backend
        That the workers are behind, who may write the mesh.
    choice : Choice
        Why it is this one.
    warnings : list of str
        What should make the user doubt the mesh; logged already.
    """

    result: Reconstruction
    grid: int
    backend: Backend
    choice: Choice
    warnings: list[str]


@contextmanager
def run_memory(
    settings: Settings,
    loaded: Loaded,
    opener: Opener,
    clock: StageClock,
    keeping: Keeping | None = None,
    executor: Executor | Client | None = None,
) -> Iterator[Outcome]:
    """Choose where a cloud in memory is reconstructed, and do it.

    Parameters
    ----------
    settings : Settings
    loaded : Loaded
    opener : Opener
    clock : StageClock
    keeping : Keeping, optional
        Where finished tiles are kept.
    executor : concurrent.futures.Executor or distributed.Client, optional
        What is open already.

    Yields
    ------
    Outcome
    """
    cloud = loaded.cloud
    grid = find_grid(settings, cloud)
    with opener.open(Job(len(cloud), grid), executor) as (opened, choice):
        backend = opened.record(clock.timeline)
        if keeping and keeping.holds_files and not all_see_folder(Path(keeping.where), backend):
            keeping = replace(keeping, is_shared=False)
        yield run_loaded(settings, loaded, grid, backend, choice, clock, keeping)


def run_loaded(
    settings: Settings,
    loaded: Loaded,
    grid: int,
    backend: Backend,
    choice: Choice,
    clock: StageClock,
    keeping: Keeping | None,
) -> Outcome:
    """Reconstruct a cloud, wherever it is, on an open backend.

    Parameters
    ----------
    settings : Settings
    loaded : Loaded
    grid : int
        Cells along the longest side.
    backend : Backend
    choice : Choice
    clock : StageClock
    keeping : Keeping or None
        Where finished tiles are kept.

    Returns
    -------
    Outcome
    """
    workforce, cloud = backend.workforce, loaded.cloud
    threads = choose_threads(workforce, len(cloud))
    tile_points = choose_tile(settings, backend)
    method = settings.method.open(
        grid, Resources(threads, tile_points, keeping, clock.progress.show_part)
    )
    log.info(
        "method %s, grid %d, backend %s, workers %d, policy %s, kernels %s",
        settings.method.name, grid, backend.name, workforce.workers, settings.policy, kernel_id(),
    )  # fmt: skip
    doubts = Deferred(partial(_doubt_points, grid, cloud))
    result = run_pipeline(cloud, method, workforce, clock, choose_steps(settings), doubts)
    warnings = _warn(settings, doubts(), result)
    if settings.target.is_something:
        with clock.stage("simplify"):
            light = simplify_surface(result.surface, settings.target)
        result = replace(result, surface=light)
        target = settings.target
        is_bound = target.faces is not None and target.tolerance is None
        if is_bound and len(light.whole.faces) > (target.faces or 0):
            warnings.append(f"{len(light.whole.faces)} faces are left: fewer would break the mesh")
            log.warning("warning: %s", warnings[-1])
    return Outcome(result, grid, backend, choice, warnings)


@dataclass(frozen=True, slots=True, eq=False)
class _Doubts:
    """What the points give to doubt of, and what their mesh is judged by; see `doubts`."""

    resolution: list[str]
    normals: list[str]
    sides: list[str]
    low: FloatArray
    high: FloatArray
    step: float


def _doubt_points(grid: int, cloud: ArrangedCloud) -> _Doubts:
    low, high, points = cloud.low, cloud.high, cloud.sample(SAMPLE)
    step = float((high - low).max()) / grid
    resolution = doubt_resolution(points, step)
    normals = [] if resolution else doubt_normals(points)
    sides = [] if resolution or normals else doubt_sides(points)
    return _Doubts(resolution, normals, sides, low, high, step)


def _warn(settings: Settings, found: _Doubts, result: Reconstruction) -> list[str]:
    """Log what should make the user doubt the mesh, and return it for the report."""
    doubts = found.resolution + found.normals
    if not result.facts.get("open", False):
        doubts += found.sides  # of an open mesh, nothing is guessed behind the points
        # Too few cells explain a mesh that is too large.
        if not found.resolution and settings.method.makes_closed_meshes:
            doubts += doubt_closure(found.low, found.high, result.surface, found.step)
    elif result.facts.get("room", False):
        doubts.append(
            "the points are taken for a room seen from inside, for their normals face inwards: "
            "if they are of an object, turn them around"
        )
    for doubt in doubts:
        log.warning("warning: %s", doubt)
    return doubts
