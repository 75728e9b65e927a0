"""One reconstruction job from file to file: what ``hpcapp reconstruct`` runs.

::

    file ─> cloud, in memory or in a folder ─> pipeline ─> surface in parts ─> file
"""

from __future__ import annotations

import logging
import shlex
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcapp.applications.surface.job.backend_choice import Opener, approach_workers
from hpcapp.applications.surface.job.folder import find_point_workers
from hpcapp.applications.surface.job.plan import JobPlan, Place, plan_job
from hpcapp.applications.surface.job.scan import Loaded, PointFolder
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.job.site import Site, open_site
from hpcapp.applications.surface.job.storage import JobStorage, open_storage
from hpcapp.applications.surface.methods.method import TILE_POINTS
from hpcapp.applications.surface.pipeline import deliver, load, reconstruct_cloud
from hpcapp.applications.surface.steps.report import describe_outcome
from hpcapp.backends.selection import Backend
from hpcapp.cancellation import Cancellation
from hpcapp.communicator.scheduling.verification import Verification, attempt, repeat_until_trusted
from hpcapp.io import describe_losses, place_mesh
from hpcapp.io.output import open_output
from hpcapp.kernels.freed_memory import keep_memory
from hpcapp.progress import Progress, StageClock
from hpcapp.timeline import Timeline

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from distributed import Client

    from hpcapp.applications.surface.attributes.carrying import Carrying
    from hpcapp.applications.surface.job.outcome import Outcome
    from hpcapp.backends.local_cluster import LocalMachines


log = logging.getLogger("hpcapp")


def run_job(
    settings: JobSettings,
    progress: Progress,
    machines: LocalMachines | None = None,
    timeline: Timeline | None = None,
) -> dict[str, Any]:
    """Reconstruct a mesh from file to file, and return the job's report.

    `machines` are what `selection.start_early` has started; the timeline is filled here, for others
    to look at. The report's values are JSON, its keys in ``docs/reference/reconstruct.md``. Raises
    HpcError, whatever went wrong; no output is left half written.
    """
    verification = Verification(settings.verify)
    plan = plan_job(settings)
    if (excess := plan.say_excess()) is not None:
        log.warning("warning: %s", excess)

    def run(is_first: bool) -> dict[str, Any]:
        again = settings if is_first else replace(settings, resume=False)
        ready = machines if is_first else None
        return _run_once(again, plan, StageClock(progress, timeline), ready, verification)

    report = repeat_until_trusted(verification, run)
    if verification.verified or verification.liars:
        log.info("%s", verification.describe())
    return report


def _run_once(
    settings: JobSettings,
    plan: JobPlan,
    clock: StageClock,
    machines: LocalMachines | None,
    verification: Verification,
) -> dict[str, Any]:
    """Run a job, or one more attempt at it without those who have lied."""
    with (
        keep_memory() if settings.max_memory is None else nullcontext(),
        open_output(settings.output) as target,
        open_storage(settings, plan.place) as storage,
        attempt(verification),
    ):
        report = _run_in(settings, plan, storage, target, clock, machines, verification)
        if settings.details:
            report["timeline"] = clock.timeline.to_json()
        clock.progress.wait_for_viewers()  # what is kept goes with the storage
    report["stages"] = {name: round(seconds, 6) for name, seconds in clock.seconds.items()}
    return report


def _run_in(
    settings: JobSettings,
    plan: JobPlan,
    storage: JobStorage,
    target: Path,
    clock: StageClock,
    machines: LocalMachines | None,
    verification: Verification,
) -> dict[str, Any]:
    """Run a job that has room for its points.

    Where they lie in a folder, workers are there before them, to go through them.
    """
    with (
        approach_workers(settings, plan.job, machines, verification) as opener,
        load_stored(settings, plan, storage, opener, clock) as (loaded, site),
        reconstruct_cloud(settings, loaded, site, clock) as outcome,
    ):
        return _write(settings, loaded, outcome, target, clock, verification)


@contextmanager
def load_stored(
    settings: JobSettings,
    plan: JobPlan,
    storage: JobStorage,
    opener: Opener,
    clock: StageClock,
    executor: Executor | Client | None = None,
    cancellation: Cancellation | None = None,
) -> Iterator[tuple[Loaded, Callable[[int], AbstractContextManager[Site]]]]:
    """Load the points of a job to where it has room for them; see `open_site` for the others.

    Yields these, and what opens where the job runs, as `reconstruct_cloud` asks for.
    """
    checkpoint = storage.checkpoint
    with ExitStack() as stack:
        opened = folder = None
        if storage.folder is not None:
            backend, choice = stack.enter_context(opener.open(plan.job, executor))
            opened = backend.record(clock.timeline), choice
            if backend.workforce.in_process and plan.place is Place.SHARED:  # nobody else reads
                checkpoint = None if settings.room is None else checkpoint
            else:
                folder = _open_folder(settings, plan, storage.folder, opened[0])
        loaded = load(settings, clock, folder, storage.frame)
        storage.note_frame()
        loaded.report(settings.shown)
        yield loaded, partial(
            open_site, len(loaded.cloud), opener, clock,
            checkpoint=checkpoint, opened=opened, executor=executor, cancellation=cancellation,
        )  # fmt: skip


def _open_folder(settings: JobSettings, plan: JobPlan, path: Path, backend: Backend) -> PointFolder:
    """Return the folder that the points are put into."""
    log.info("the points are put into %s", path)
    points = plan.tile or TILE_POINTS
    return PointFolder(path, find_point_workers(settings.points, path, backend, points))


def _write(
    settings: JobSettings,
    loaded: Loaded,
    outcome: Outcome,
    target: Path,
    clock: StageClock,
    verification: Verification,
) -> dict[str, Any]:
    """Write the mesh, and describe what came of the job."""
    outcome, carrying, topology = deliver(settings, loaded, outcome, target, clock)
    report = describe_outcome(settings, loaded, outcome, topology, carrying)
    mesh = carrying.to_stream(outcome.result.surface.stream())
    placed = place_mesh(target, mesh, carrying.placement)
    report["warnings"] += describe_losses(target, placed)
    report["origin"] = placed.shift.tolist()
    report["input"] = loaded.described
    report["command"] = shlex.join(settings.command)
    if verification.machines or verification.liars:
        report["verification"] = verification.to_json()
    if settings.details:
        from hpcapp.applications.surface.steps.report_page import find_owners

        owners = find_owners(outcome.result)
        report |= {} if owners is None else {"owners": owners.to_json()}
    if settings.report is not None or settings.png is not None:
        with clock.stage("show"):
            _show(settings, loaded, outcome, carrying, clock, report)
    return report


def _show(
    settings: JobSettings,
    loaded: Loaded,
    outcome: Outcome,
    carrying: Carrying,
    clock: StageClock,
    report: dict[str, Any],
) -> None:
    """Write the job's page and picture."""
    from hpcapp.applications.surface.steps.report_page import find_up, show_job, write_job_page
    from hpcapp.pages.picture import write_picture

    shown = show_job(loaded, outcome, carrying)
    if settings.png is not None:
        unit, up = report["input"]["unit"], find_up(report, shown.mesh)
        write_picture(settings.png, shown.mesh, up=up, unit=unit)
    if settings.report is not None:
        whole = {**report, "stages": clock.seconds, "timeline": clock.timeline.to_json()}
        write_job_page(settings.report, shown, whole, Path(settings.output).name)
