"""Where a cloud is reconstructed, and what a method gets there."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.measure import replace_points
from hpcapp.applications.surface.job.backend_choice import BackendChoice, Job, Opener
from hpcapp.applications.surface.job.folder import all_see_folder
from hpcapp.applications.surface.job.plan import choose_tile
from hpcapp.applications.surface.job.settings import Settings, choose_steps, choose_threads
from hpcapp.applications.surface.methods.method import Method, Resources, show_nothing
from hpcapp.applications.surface.tiles.checkpoint import Checkpoint
from hpcapp.backends.selection import Backend
from hpcapp.cancellation import Cancellation
from hpcapp.kernels.build import kernel_id
from hpcapp.progress import StageClock
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from distributed import Client


log = logging.getLogger("hpcapp")


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """A backend that is open, why it is this one, and where finished tiles are kept."""

    backend: Backend
    choice: BackendChoice
    checkpoint: Checkpoint | None


@contextmanager
def open_site(
    points: int,
    opener: Opener,
    clock: StageClock,
    grid: int,
    *,
    checkpoint: Checkpoint | None = None,
    opened: tuple[Backend, BackendChoice] | None = None,
    executor: Executor | Client | None = None,
    cancellation: Cancellation | None = None,
) -> Iterator[Site]:
    """Choose where so many points are reconstructed, and open it.

    The clock's timeline has what the backend does; `grid` cells lie along the longest side.
    Finished tiles are kept by the `checkpoint`. `opened` is where it is reconstructed, if that is
    open and recorded already, `executor` what the user has opened; `cancellation` may end it.
    """
    job = Job(points, grid)
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
        yield Site(recorded, choice, checkpoint)


def preprocess(settings: Settings, cloud: ArrangedCloud, clock: StageClock) -> ArrangedCloud:
    """Take the steps of the paper's preprocessing that are asked for.

    Raise UsageError where not all points are in memory.
    """
    for name, step in choose_steps(settings):
        refusal = UsageError(
            f"the step '{name}' needs all points in memory",
            f"leave it out, or give more {name_option('max_memory')}",
        )
        with clock.stage(name):
            cloud = replace_points(cloud, step(cloud.take_all(0, refusal)))
    return cloud


def open_method(
    settings: Settings, site: Site, grid: int, cloud: ArrangedCloud, clock: StageClock
) -> Method[Any, Any]:
    """Open the method for a cloud, and log what runs where."""
    backend, workforce = site.backend, site.backend.workforce
    threads = choose_threads(workforce, len(cloud))
    tile_points = choose_tile(settings, backend, cloud)
    show_part = clock.progress.show_part if clock.progress.shows_parts else show_nothing
    method = settings.method.open(grid, Resources(threads, tile_points, site.checkpoint, show_part))
    log.info(
        "method %s, grid %d, backend %s, workers %d, policy %s, kernels %s",
        settings.method.name, grid, backend.name, workforce.workers, settings.policy, kernel_id(),
    )  # fmt: skip
    return method
