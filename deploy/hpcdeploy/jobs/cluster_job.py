"""A job from beginning to end as its user sees it: submit, watch, fetch, and leave nothing behind.

Whoever watches also looks after the cluster: workers that vanish, as spot machines do, are
replaced meanwhile.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Sequence
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Self

from hpccomponent.cli.terminal import visible_line
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError, HpcError, OutputError, UsageError
from hpcdeploy.jobs.display import ForwardingDisplay, open_display
from hpcdeploy.jobs.queries import Jobs, open_jobs
from hpcdeploy.provider import State
from hpcdeploy.reconcile.cluster import as_desired, open_cluster
from hpcdeploy.reconcile.cost import hourly_cost
from hpcdeploy.spec.job_folder import UNTOLD, JobRequest, JobStatus
from hpcdeploy.spec.layout import machine_folder

if TYPE_CHECKING:
    from hpcdeploy.reconcile.cluster import Cluster


log = logging.getLogger("hpcapp")

LOOK_S = 30.0  # between two looks for workers that have vanished
QUICK_S, LEAVE_S = 1.0, 60.0  # until the replacing of workers has ended: without a word, and in all


def run_on_cluster(
    path: Path,
    verb: str,
    points: Path,
    target: Path,
    options: Sequence[str],
    typed: Sequence[str] = (),
) -> dict[str, object]:
    """Run a verb on a cluster: up if needed, submit, watch, fetch, and down if it was us.

    `path` is the cluster file, `typed` the command line without the program's name. In the verb's
    report, ``cost`` is what the cluster costs at most, in dollars an hour and for as long as the
    job took from here, where it costs something and all prices are known.

    Raises HpcError with what the verb failed with, or where the cluster cannot be had, reached or
    taken away; KeyboardInterrupt where the user has detached: the job goes on.
    """
    with open_cluster(path) as cluster:
        cluster, is_ours = _bring_up_if_needed(cluster)
        stays, start = False, time.monotonic()
        replacements = _replacing_lost(cluster)
        try:
            jobs = open_jobs(cluster)
            request = make_request(cluster, typed)
            status = submit(jobs, verb, points, target.name, options, request)
            try:
                with replacements:
                    status = _follow(cluster, jobs, status, has_page="--dashboard" in options)
            except (KeyboardInterrupt, CloudError):
                stays = True
                if is_ours:
                    log.info("the cluster stays up for it: hpcapp down %s ends it", path)
                raise
            if not is_ours:
                replacements.wait()
            report = fetch(jobs, status, target)
            return report | _describe_cost(cluster, time.monotonic() - start)
        finally:
            if is_ours and not stays:
                from hpcdeploy.reconcile.converge import take_down

                if cluster.provider.makes_machines:
                    cluster.access.close()  # a worker that is being set up is not needed any more
                replacements.wait()  # it holds the journal
                take_down(cluster, log.info)


def _describe_cost(cluster: Cluster, seconds: float) -> dict[str, object]:
    """Return what a job has cost at most, for its report; nothing where that is not known."""
    hourly = hourly_cost(cluster.spec)
    if hourly is None:
        return {}
    job = hourly * seconds / 3600.0
    return {"cost": {"dollars_an_hour": round(hourly, 4), "dollars_job": round(job, 4)}}


def check_job(
    cluster: Cluster, verb: str, points: Path, target: Path, options: Sequence[str]
) -> Sequence[str]:
    """Let whoever knows the verb look at a job before anything travels; return the head's options.

    The head has no other files of this machine than the points. Raises UsageError where the options
    are wrong or `target` cannot be written, InputError where the points will not do.
    """
    for entry in entry_points(group="hpc.checks", name=verb):
        options = entry.load()(cluster.path, points, target, options)
    return options


def _bring_up_if_needed(cluster: Cluster) -> tuple[Cluster, bool]:
    """Make the cluster work, as it was asked for last; tell whether nothing was there before."""
    from hpcdeploy.reconcile.converge import bring_up

    observed = cluster.provider.observe(cluster.spec.cluster)
    cluster = as_desired(cluster, observed)
    was_there = any(machine.state is not State.GONE for machine in observed.machines)
    if was_there and _is_set_up(cluster):
        return cluster, False
    bring_up(cluster, log.info)
    return cluster, not (was_there and cluster.provider.makes_machines)


def _is_set_up(cluster: Cluster) -> bool:
    """Tell whether there is a head with an inventory."""
    try:
        head = cluster.access.open(cluster.head())
    except CloudError:
        return False
    inventory = f"{machine_folder(cluster.spec.cluster)}/inventory.json"
    return head.run(f"test -f {inventory}").exit_code == 0


def make_request(cluster: Cluster, typed: Sequence[str]) -> JobRequest:
    """Return what the head is to remember of a job: the command, and the cluster's price by now.

    `typed` is the command line without the program's name.
    """
    if cluster.spec.provider.cloud is not None:  # nothing else has a price
        cluster = as_desired(cluster, cluster.provider.observe(cluster.spec.cluster))
    return JobRequest(tuple(typed), str(Path.cwd()), hourly_cost(cluster.spec))


def submit(
    jobs: Jobs,
    verb: str,
    points: Path,
    mesh: str,
    options: Sequence[str],
    request: JobRequest = UNTOLD,
) -> JobStatus:
    """Put a job into the queue, and show how its points travel.

    Raises InputError where the input cannot be read, CloudError where the head or the bucket cannot
    be reached, or does not take it.
    """
    with open_display(sys.stderr) as display:
        on_progress = partial(display.show_bytes, "send")
        status = jobs.submit(verb, points, mesh, options, on_progress, request)
    log.info("job %s of %s is %s", status.job, points, status.state)
    return status


def fetch(jobs: Jobs, status: JobStatus, target: Path) -> dict[str, object]:
    """Fetch a finished job's mesh, and show how it travels; return the report of its verb.

    Raises JobError where the job is not done, other errors by the exit code of its verb, and
    CloudError where the mesh does not come.
    """
    with open_display(sys.stderr) as display:
        return jobs.fetch(status, target, partial(display.show_bytes, "fetch"))


def new_mesh_here(status: JobStatus) -> Path:
    """Return the place in the present folder for a job's mesh, by the name that its head tells.

    It is a new file or a new folder, with a mesh's suffix. Raises OutputError where the name leads
    elsewhere, hides the file, is an option to other commands, holds what a terminal would obey or
    is not that of a mesh; or where something is there.
    """
    name = status.mesh
    if not name or "/" in name or name[0] in ".-~" or visible_line(name) != name:
        raise OutputError(f"{name!r} is no name for a new file here", "name one by -o")
    if os.path.lexists(name):
        raise OutputError(f"{name} is there already", f"give -o {name} to replace it")
    target = Path(name)
    for entry in entry_points(group="hpc.checks", name="mesh"):
        entry.load()(target)
    return target


def watch(cluster: Cluster, jobs: Jobs, status: JobStatus, *, has_page: bool = False) -> JobStatus:
    """Show a job from its beginning until it has ended, replacing lost workers; return how.

    `has_page` leads to its dashboard from here. The job goes on after KeyboardInterrupt, and may
    well after CloudError, where the head cannot be reached any more.
    """
    with _replacing_lost(cluster) as replacements:
        ended = _follow(cluster, jobs, status, has_page=has_page)
    replacements.wait()
    return ended


def _follow(cluster: Cluster, jobs: Jobs, status: JobStatus, *, has_page: bool) -> JobStatus:
    """Show a job until it has ended; say how to go on where that is not seen from here."""
    again = f"hpcapp attach {cluster.path} {status.job}"
    try:
        with open_display(sys.stderr) as display:
            if not has_page or status.state.is_over:
                return jobs.follow(status.job, display)
            forwarding = ForwardingDisplay(display, jobs.forward)
            ended = jobs.follow(status.job, forwarding)
            if not forwarding.has_page:
                log.warning(
                    "warning: job %s had no dashboard: submit it with --dashboard", ended.job
                )
            return ended
    except KeyboardInterrupt:
        log.info("detached: job %s goes on; %s shows it again, hpcapp cancel %s %s ends it",
                 status.job, again, cluster.path, status.job)  # fmt: skip
        raise
    except CloudError as error:
        raise CloudError(error.problem, f"the job may go on: {again}") from error


class _OverError(Exception):
    """Nobody watches any more."""


@dataclass(frozen=True, slots=True)
class _Replacements:
    """Replaces lost workers while a block runs; what it has begun then stands in the journal."""

    is_over: threading.Event
    thread: threading.Thread
    is_needed: bool

    def __enter__(self) -> Self:
        if self.is_needed:
            self.thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.is_over.set()  # who has interrupted is let go at once

    def wait(self) -> None:
        """Wait until nothing is being replaced any more, for a while."""
        if self.thread.is_alive():
            self.thread.join(QUICK_S)
        if self.thread.is_alive():
            log.info("waiting until a lost worker is replaced, %.0f s at most", LEAVE_S)
            self.thread.join(LEAVE_S)


def _replacing_lost(cluster: Cluster) -> _Replacements:
    """Return what replaces workers that vanish, now and then."""
    from hpcdeploy.reconcile.converge import replace_lost
    from hpcdeploy.spec.polling import Polling

    is_over = threading.Event()

    def sleep(seconds: float) -> None:
        if is_over.wait(seconds):
            raise _OverError

    def look(present: Cluster) -> None:
        warned = ""
        while not is_over.wait(LOOK_S):
            try:
                seen = present.provider.observe(present.spec.cluster)
                present = as_desired(present, seen, log.info)  # also where the rest fails
                present = replace_lost(present, log.info, polling=Polling(sleep=sleep), seen=seen)
            except _OverError:
                return  # what was begun stands in the journal
            except UsageError as error:
                if warned != str(error):
                    log.warning("warning: lost workers are not replaced: %s", error)
                warned = str(error)
            except HpcError as error:
                log.debug("lost workers are not replaced: %s", error)

    thread = threading.Thread(target=look, args=(cluster,), name="replacements", daemon=True)
    return _Replacements(is_over, thread, cluster.provider.makes_machines)
