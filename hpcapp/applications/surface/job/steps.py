"""The steps from a loaded cloud to its surface: the same for files and for arrays."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hpcapp.applications.surface.checkpoint import Checkpoint
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.job.backend_choice import Choice, Job, Opener
from hpcapp.applications.surface.job.diagnostics import (
    SAMPLE,
    check_closure,
    check_handles,
    check_resolution,
    check_sides,
    check_support,
)
from hpcapp.applications.surface.job.folder import all_see_folder, choose_tile
from hpcapp.applications.surface.job.load import Loaded
from hpcapp.applications.surface.job.resolution import find_grid
from hpcapp.applications.surface.kernels.build import kernel_id
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
from hpcapp.cancellation import Cancellation
from hpcapp.geometry.points import FloatArray
from hpcapp.progress import StageClock
from hpccomponent.runtime.background import Deferred

if TYPE_CHECKING:
    from distributed import Client


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
def run_steps(
    settings: Settings,
    loaded: Loaded,
    opener: Opener,
    clock: StageClock,
    checkpoint: Checkpoint | None = None,
    *,
    opened: tuple[Backend, Choice] | None = None,
    executor: Executor | Client | None = None,
    cancellation: Cancellation | None = None,
) -> Iterator[Outcome]:
    """Choose where a cloud is reconstructed, and do it.

    Parameters
    ----------
    settings : Settings
    loaded : Loaded
    opener : Opener
    clock : StageClock
    checkpoint : Checkpoint, optional
        Where finished tiles are kept.
    opened : tuple of (Backend, Choice), optional
        Where it is reconstructed, if that is open and recorded already.
    executor : concurrent.futures.Executor or distributed.Client, optional
        What the user has opened.
    cancellation : Cancellation, optional
        By which somebody may end it.
    """
    grid = find_grid(settings, loaded.cloud)
    job = Job(len(loaded.cloud), grid)
    with nullcontext(opened) if opened else opener.open(job, executor) as (backend, choice):
        recorded = backend if opened else backend.record(clock.timeline)
        if cancellation is not None:
            recorded = recorded.heed(cancellation)
        if (
            checkpoint
            and checkpoint.holds_files
            and not all_see_folder(Path(checkpoint.where), recorded)
        ):
            checkpoint = replace(checkpoint, is_shared=False)
        yield _run(settings, loaded, grid, recorded, choice, clock, checkpoint)


def _run(
    settings: Settings,
    loaded: Loaded,
    grid: int,
    backend: Backend,
    choice: Choice,
    clock: StageClock,
    checkpoint: Checkpoint | None,
) -> Outcome:
    """Reconstruct a cloud on an open backend."""
    workforce, cloud = backend.workforce, loaded.cloud
    threads = choose_threads(workforce, len(cloud))
    tile_points = choose_tile(settings, backend)
    method = settings.method.open(
        grid, Resources(threads, tile_points, checkpoint, clock.progress.show_part)
    )
    log.info(
        "method %s, grid %d, backend %s, workers %d, policy %s, kernels %s",
        settings.method.name, grid, backend.name, workforce.workers, settings.policy, kernel_id(),
    )  # fmt: skip
    checks = Deferred(partial(_check_points, grid, cloud))
    result = run_pipeline(cloud, method, workforce, clock, choose_steps(settings), checks)
    warnings = _warn(settings, loaded, checks(), result)
    if settings.target.is_something:
        with clock.stage("simplify"):
            light = simplify_surface(result.surface, settings.target)
        result = replace(result, surface=light)
        target = settings.target
        is_bound = target.faces is not None and target.tolerance is None
        faces = light.stream().face_count
        if is_bound and faces > (target.faces or 0):
            warnings.append(f"{faces:,} faces are left: fewer would break the mesh")
            log.warning("warning: %s", warnings[-1])
    return Outcome(result, grid, backend, choice, warnings)


@dataclass(frozen=True, slots=True, eq=False)
class _PointChecks:
    """What is suspicious of the points, and what their mesh is judged by; see `diagnostics`."""

    resolution: list[str]
    sides: list[str]
    low: FloatArray
    high: FloatArray
    step: float


def _check_points(grid: int, cloud: ArrangedCloud) -> _PointChecks:
    low, high, points = cloud.low, cloud.high, cloud.sample(SAMPLE)
    step = float((high - low).max()) / grid
    resolution = check_resolution(points, step)
    sides = [] if resolution else check_sides(points)
    return _PointChecks(resolution, sides, low, high, step)


def _warn(
    settings: Settings, loaded: Loaded, checks: _PointChecks, result: Reconstruction
) -> list[str]:
    """Log what should make the user doubt the mesh, and return it for the report."""
    warnings = [*checks.resolution]
    is_open = result.facts.get("open", False)
    # Where sides were looked for, that has been judged; of an open mesh, nothing is guessed.
    if loaded.oriented.is_believed and (not is_open or result.facts.get("room", False)):
        warnings += checks.sides
    # Too few cells explain a mesh that is too large.
    if not (is_open or checks.resolution) and settings.method.makes_closed_meshes:
        warnings += check_closure(checks.low, checks.high, result.surface, checks.step)
        warnings += check_handles(result.surface, loaded.cleaned.line_gap)
        warnings += check_support(result.facts)
    for warning in warnings:
        log.warning("warning: %s", warning)
    return warnings
