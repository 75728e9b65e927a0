"""Jobs as seen from outside: one command on the head for each question.

Nothing is remembered on the user's machine: whoever reaches the head sees all jobs.
"""

from __future__ import annotations

import json
import shlex
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import (
    CloudError,
    HpcError,
    InputError,
    JobError,
    UsageError,
)
from hpccomponent.foreign_json import convert, decode
from hpcdeploy.jobs.display import JobDisplay, JobEvent
from hpcdeploy.login.shell import Shell, sha256_of
from hpcdeploy.provider import Bucket
from hpcdeploy.spec.job_folder import (
    UNTOLD,
    JobOrder,
    JobRequest,
    JobState,
    JobStatus,
    Number,
    Words,
)
from hpcdeploy.spec.layout import machine_folder

if TYPE_CHECKING:
    from hpcdeploy.reconcile.cluster import Cluster


_ERRORS: dict[int, type[HpcError]] = {2: UsageError, 3: InputError, 4: CloudError}
TIMEOUT_S = 60.0
EXCERPT = 5
_MOST_EXCERPT = 500  # characters


@dataclass(frozen=True, slots=True)
class _JobLine:
    """A line of `runner` while a job is followed: one of these."""

    log: Words | None = None
    event: JobEvent | None = None
    status: JobStatus | None = None


@dataclass(frozen=True, slots=True)
class _Numbered:
    job: Number


@dataclass(frozen=True, slots=True)
class _Summary:
    summary: Words


class Jobs:
    """The jobs of a cluster; points and meshes go by its bucket, or by the shell without one."""

    def __init__(self, head: Shell, cluster: str, bucket: Bucket | None = None) -> None:
        self._head = head
        self._folder = machine_folder(cluster)
        self._bucket = bucket

    def submit(
        self,
        verb: str,
        points: Path,
        mesh: str,
        options: Sequence[str] = (),
        on_progress: Callable[[int, int], None] | None = None,
        request: JobRequest = UNTOLD,
    ) -> JobStatus:
        """Send the points, and put a job into the queue.

        A cloud on the head already is not sent again. Raises InputError where the input cannot be
        read, CloudError where head or bucket cannot be reached, or does not take it.
        """
        try:
            digest = sha256_of(points)
        except OSError as error:
            raise InputError(
                f"{points}: cannot be read ({error.strerror})", "name a file that you may read"
            ) from error
        name = f"points/{digest}{points.suffix}"
        order = JobOrder(verb, name, mesh, tuple(options), points.name, request=request)
        if self._bucket is not None:
            order = self._bucket.send(points, digest, order, on_progress)
        else:
            self._run(f"umask 077; mkdir -p {shlex.quote(self._folder)}/points")
            self._head.put(points, f"{self._folder}/{name}", on_progress=on_progress)
        return self._ask_status("start", stdin=json.dumps(asdict(order)).encode())

    def all(self) -> list[JobStatus]:
        """Return all jobs in their order, with those of which the head says nothing of use."""
        return [_read_row(line) for line in self._ask("list")]

    def find(self, number: str | None) -> JobStatus:
        """Return one job, the last without a number; raise UsageError where there is none."""
        jobs = self.all()
        if number is None and jobs:
            return jobs[-1]
        for status in jobs:
            if status.job == number:
                return status
        known = ", ".join(status.job for status in jobs)
        raise UsageError(
            f"there is no job {number}" if number else "no job was submitted yet",
            f"the jobs are {known}" if known else "submit one with 'hpcapp submit'",
        )

    def log(self, number: str) -> list[str]:
        """Return what a job has said so far."""
        return self._ask("log", number)

    def follow(self, number: str, display: JobDisplay) -> JobStatus:
        """Show a job from its beginning until it has ended; return how.

        Raises CloudError where the head stops answering before that.
        """
        ended: JobStatus | None = None
        rest: deque[str] = deque(maxlen=EXCERPT)

        def show(line: str) -> None:
            nonlocal ended
            try:
                told = decode(line, _JobLine)
            except ValueError:
                rest.append(line)  # no line of ours: an error of the machine
                return
            if told.log is not None:
                display.show_log(told.log)
            if told.event is not None:
                display.show_event(told.event)
            ended = told.status or ended

        code = self._head.follow(f"{self._command('follow', number)} 2>&1", show)
        if ended is None:
            said, excerpt = _said(rest, code)
            raise CloudError(
                f"{self._head.node}: job {number} cannot be followed ({said})",
                "look at hpcapp logs and hpcapp doctor",
                excerpt,
            )
        return ended

    def forward(self, port: int) -> int:
        """Return a port here that leads to one of the head's loopback until the cluster is left."""
        return self._head.forward("127.0.0.1", port)

    def cancel(self, number: str) -> JobStatus:
        """End a job, and return its status when nothing of it runs any more."""
        return self._ask_status("cancel", number)

    def report(self, status: JobStatus) -> dict[str, object]:
        """Return what the verb of a finished job reported; its `summary` is for people.

        Raises CloudError where the head has none of use.
        """
        place = f"{self._folder}/jobs/{status.job}"
        lines = self._run(f"cat {shlex.quote(place)}/report.json")
        try:
            report: dict[str, object] = decode("\n".join(lines), dict[str, object])
            convert(report, _Summary)
        except ValueError as error:
            raise CloudError(
                f"{self._head.node}: job {status.job}: its report is damaged ({error})",
                f"the mesh comes by 'hpcapp get FILE {place}/{status.mesh}'",
            ) from None
        return report

    def fetch(
        self,
        status: JobStatus,
        target: Path,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> dict[str, object]:
        """Fetch a finished job's mesh; return its report.

        `on_progress` is told (bytes fetched, bytes in all), though not by a bucket. Raises as
        `raise_failure` does, and CloudError where the mesh does not come.
        """
        raise_failure(status)
        report = self.report(status)
        if self._bucket is not None and status.mesh_sha256:
            self._bucket.fetch(status, target)
        else:
            source = f"{self._folder}/jobs/{status.job}/{status.mesh}"
            self._head.get(source, target, on_progress=on_progress)
        return report

    def _command(self, *words: str) -> str:
        python = f"{self._folder}/venv/bin/python"
        parts = [python, "-P", "-m", "hpcdeploy.jobs.runner", "--folder", self._folder, *words]
        return f"exec {shlex.join(parts)}"

    def _ask(self, *words: str, stdin: bytes = b"") -> list[str]:
        return self._run(self._command(*words), stdin=stdin)

    def _ask_status(self, *words: str, stdin: bytes = b"") -> JobStatus:
        """Ask what is answered with one status."""
        answer = "\n".join(self._ask(*words, stdin=stdin))
        try:
            return JobStatus.from_json(answer)
        except ValueError as error:
            raise CloudError(
                f"{self._head.node}: its answer is no status of a job ({error})",
                "run 'hpcapp doctor'",
                answer[-_MOST_EXCERPT:],
            ) from None

    def _run(self, command: str, *, stdin: bytes = b"") -> list[str]:
        """Run a command on the head; return its lines."""
        done = self._head.run(command, stdin=stdin, timeout_s=TIMEOUT_S)
        if done.exit_code != 0:
            said, excerpt = _said(done.errors.strip().splitlines(), done.exit_code)
            kind = _ERRORS.get(done.exit_code, CloudError)
            raise kind(f"{self._head.node}: {said}", "", excerpt)
        return done.output.splitlines()


def _read_row(line: str) -> JobStatus:
    """Return the job of a line of the head's list, whatever it says."""
    try:
        return JobStatus.from_json(line)
    except ValueError as error:
        reason = f"the head says no status of it ({error})"
    try:
        number = decode(line, _Numbered).job
    except ValueError:
        number = "?"
    return JobStatus(number, JobState.DAMAGED, reason=reason)


def _said(lines: Iterable[str], code: int) -> tuple[str, str]:
    """Return the last line that a command has said, and where it said more, its last lines."""
    last = [line.strip() for line in lines][-EXCERPT:]
    if not last:
        return f"exit code {code}", ""
    return last[-1], "\n".join(last) if len(last) > 1 else ""


def open_jobs(cluster: Cluster) -> Jobs:
    """Return the jobs of a cluster that is up."""
    head = cluster.access.open(cluster.head())
    bucket = cluster.provider.bucket()
    return Jobs(head, cluster.spec.cluster, bucket)


def raise_damage(statuses: Sequence[JobStatus]) -> None:
    """Raise CloudError with the first reason where the status of a job cannot be read."""
    damaged = [status for status in statuses if status.state is JobState.DAMAGED]
    if damaged:
        numbers = ", ".join(status.job for status in damaged)
        raise CloudError(
            f"job {numbers}: {damaged[0].reason}",
            "'hpcapp logs' tells what it has said, and 'hpcapp get' brings files of its folder",
        )


def raise_failure(status: JobStatus) -> None:
    """Raise what ended a job, as the verb itself would have; nothing where it is done.

    UsageError, InputError and CloudError go by the exit code of its verb; CloudError also where its
    status cannot be read. Any other failure, no end yet, or a cancellation is a JobError.
    """
    if status.state is JobState.DONE:
        return
    raise_damage([status])
    if not status.state.is_over:
        raise JobError(f"job {status.job} is {status.state}", "wait for it with 'hpcapp attach'")
    if status.state is JobState.CANCELLED:
        raise JobError(f"job {status.job} was cancelled")
    kind = _ERRORS.get(status.exit_code or 1, JobError)
    why = status.reason or f"exit code {status.exit_code or 1}"
    raise kind(f"job {status.job} {status.state}: {why}")
