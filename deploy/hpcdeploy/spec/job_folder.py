"""What a job leaves on the head, and what can be read from it.

::

    hpcapp/CLUSTER/
      points/SHA256.SUFFIX   each cloud once, however many jobs read it
      jobs/queue.lock        held while a job is given its number
      jobs/N/
        job.json             what to do; 0600, as it may hold the addresses of a bucket
        lock                 held by the runner, and by what it runs: the job lives
        status.json          where it stands, written by the runner alone
        log, events.jsonl    what it says, for people and for programs
        report.json, mesh.*  what came out; beside it a link to the points

What is read here, on the head or as the head's answer, is not trusted: `JobStatus` and `JobOrder`
say by their types what each entry may be.

The lock is the system's own word on whether a job lives: whoever holds it may be killed, and it
is free. So a job that says "running" while its lock is free has lost its runner.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError
from hpccomponent.foreign_json import decode

EXIT_FAILED = 1
EXIT_CANCELLED = 130
_NUMBER = re.compile(r"[1-9][0-9]{0,8}")

Number = Annotated[str, Meta(pattern=rf"^{_NUMBER.pattern}\Z")]
"""Of a job: part of paths and of commands."""
FileName = Annotated[str, Meta(pattern=r"^(?!\.{1,2}\Z)[^/\x00]{0,255}\Z")]
"""Of a file in the job's folder, or nothing."""
Moment = Annotated[str, Meta(pattern=r"^([0-9]{4}(-[0-9]{2}){2}T[0-9]{2}(:[0-9]{2}){2}\+00:00)?\Z")]
"""UTC, ISO 8601, in whole seconds, or nothing."""
Words = Annotated[str, Meta(max_length=1 << 16)]
"""For people."""


class JobState(StrEnum):
    """Where the life of a job stands."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"
    DAMAGED = "damaged"
    """What was written of it cannot be read; what it is to do may go on."""

    @property
    def is_over(self) -> bool:
        """Whether nothing will change any more."""
        return self not in (JobState.QUEUED, JobState.RUNNING)


@dataclass(frozen=True, slots=True)
class JobRequest:
    """What was typed for a job, and what its cluster costs.

    `words` are without the program's name, and were typed in `folder`. `hourly_cost` is the
    cluster's as it was then, at most, in dollars; None where it has no price.
    """

    words: tuple[Words, ...] = ()
    folder: Words = ""
    hourly_cost: Annotated[float, Meta(ge=0, le=1e9)] | None = None

    def command(self, folder: str) -> str:
        """Return the command for a shell that stands in a folder, to be typed again.

        Empty where it is not known. Whatever words a head tells, it is one command, and `hpcapp`.

        Examples
        --------
        >>> typed = ("submit", "lab.yaml", "my scan.ply", "-o", "mesh.ply")
        >>> request = JobRequest(typed, "/home/me")
        >>> request.command("/home/me")
        "hpcapp submit lab.yaml 'my scan.ply' -o mesh.ply"
        >>> request.command("/tmp")
        "cd /home/me && hpcapp submit lab.yaml 'my scan.ply' -o mesh.ply"
        """
        if not self.words:
            return ""
        line = shlex.join(("hpcapp", *self.words))
        return line if self.folder == folder else f"cd {shlex.quote(self.folder)} && {line}"


UNTOLD = JobRequest()
"""Of an order by an earlier release."""


@dataclass(frozen=True, slots=True)
class JobOrder:
    """What a job is to do.

    Parameters
    ----------
    verb : str
        Of `hpcapp`: it reads `points`, writes ``-o`` `mesh` and knows ``--cluster``.
    points : str
        The input, relative to the cluster's folder; the user calls it `title`.
    points_url, mesh_url : str
        Presigned addresses in a bucket to fetch the input from and to send the output to.
    mesh_key : str
        What the output is called there.
    ca_bundle : str
        Certificates (PEM) by which the bucket's own is checked; the system's by default.
    """

    verb: str
    points: str
    mesh: FileName
    options: tuple[str, ...] = ()
    title: FileName = ""
    points_url: str = ""
    mesh_url: str = ""
    mesh_key: str = ""
    ca_bundle: str = ""
    request: JobRequest = UNTOLD

    @classmethod
    def from_json(cls, text: str | bytes) -> JobOrder:
        """Read an order; ValueError, of one line, where it is none."""
        return decode(text, cls)


@dataclass(frozen=True, slots=True)
class JobStatus:
    """Where a job stands.

    Parameters
    ----------
    title : str
        What the user calls the input.
    submitted, started, ended : str
        UTC, ISO 8601; empty while it has not happened.
    runner : int
        Process id, and id of the process group.
    mesh_key, mesh_sha256 : str
        Of a mesh that lies in the bucket as well.
    """

    job: Number
    state: JobState
    title: Words = ""
    mesh: FileName = ""
    submitted: Moment = ""
    started: Moment = ""
    ended: Moment = ""
    exit_code: Annotated[int, Meta(ge=0, le=255)] | None = None
    reason: Words = ""
    runner: Annotated[int, Meta(ge=0, le=1 << 30)] = 0
    mesh_key: Annotated[str, Meta(max_length=1024)] = ""
    mesh_sha256: Annotated[str, Meta(pattern=r"^([0-9a-f]{64})?\Z")] = ""
    request: JobRequest = UNTOLD

    def seconds(self, present: datetime) -> float | None:
        """Return how long the job ran, up to the present where it still does; None before that."""
        if not self.started or (self.state.is_over and not self.ended):
            return None
        end = datetime.fromisoformat(self.ended) if self.ended else present
        return max((end - datetime.fromisoformat(self.started)).total_seconds(), 0.0)

    def cost(self, present: datetime) -> float | None:
        """Return what the cluster cost at most while the job ran, in dollars; None if not known."""
        seconds, hourly = self.seconds(present), self.request.hourly_cost
        return None if seconds is None or hourly is None else hourly * seconds / 3600.0

    def to_json(self) -> str:
        """Return the status as one line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str | bytes) -> JobStatus:
        """Read what `to_json` wrote; what a later release added is left out."""
        return decode(text, cls)


def now() -> str:
    """Return the present moment as a status has it."""
    return datetime.now(UTC).isoformat(timespec="seconds")


class JobFolder:
    """One job's files."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.log = path / "log"
        self.events = path / "events.jsonl"
        self.report = path / "report.json"
        self._order = path / "job.json"
        self._status = path / "status.json"
        self._lock = path / "lock"

    def read_order(self) -> JobOrder:
        """Return what the job is to do."""
        try:
            return JobOrder.from_json(self._order.read_bytes())
        except ValueError as error:
            raise JobError(f"{self._order}: is damaged ({error})", "submit the job again") from None

    def write_order(self, order: JobOrder) -> None:
        """Write what the job is to do, for its owner only."""
        self._write(self._order, json.dumps(asdict(order)))

    def link_points(self, points: Path) -> str:
        """Give the job its points under the name that the user calls them; return that name.

        `points` is a file on the head, to which a link in the job's folder leads.
        """
        order = self.read_order()
        name = order.title if order.title != order.mesh else f"points-{order.title}"
        (self.path / name).symlink_to(points)
        return name

    def write_status(self, status: JobStatus) -> None:
        """Replace the status as a whole."""
        self._write(self._status, status.to_json())

    def read_status(self) -> JobStatus:
        """Return where the job stands; one whose runner was lost has failed."""
        was_alive = self.is_alive()  # first: it may end between the two looks
        try:
            status = JobStatus.from_json(self._status.read_bytes())
        except FileNotFoundError:
            raise
        except (OSError, ValueError) as error:
            reason = f"its status.json is damaged ({error})"
            return JobStatus(self.path.name, JobState.DAMAGED, reason=reason)
        if was_alive or status.state.is_over:
            return status
        return replace(
            status,
            state=JobState.FAILED,
            exit_code=EXIT_FAILED,
            reason="its runner was killed, or the head was switched off",
        )

    def is_alive(self) -> bool:
        """Tell whether the lock is held."""
        try:
            with self._open_lock() as lock:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except FileNotFoundError:
            return False
        return False

    def wait_for_end(self) -> None:
        """Sleep until the lock is free."""
        with self._open_lock() as lock:
            fcntl.flock(lock, fcntl.LOCK_SH)

    @contextmanager
    def _open_lock(self) -> Iterator[int]:
        descriptor = os.open(self._lock, os.O_RDONLY | os.O_CLOEXEC)
        try:
            yield descriptor
        finally:
            os.close(descriptor)

    def _write(self, path: Path, text: str) -> None:
        beside = path.with_name(f".{path.name}.new")
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text + "\n")
        os.replace(beside, path)


def all_jobs(folder: Path) -> list[JobFolder]:
    """Return the jobs of a cluster's folder, in the order of their numbers."""
    folders = [path for path in _numbered(folder / "jobs") if (path / "status.json").exists()]
    return [JobFolder(path) for path in sorted(folders, key=lambda path: int(path.name))]


def _numbered(jobs: Path) -> Iterator[Path]:
    return (path for path in jobs.glob("[1-9]*") if _NUMBER.fullmatch(path.name))


def _lock(path: Path) -> int:
    """Wait for a lock, and return the descriptor that holds it."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    return descriptor


def create_job(folder: Path, order: JobOrder) -> tuple[JobFolder, int]:
    """Give a job its number and its place in the queue; return it and the descriptor of its lock.

    The lock was taken before any later job could look.
    """
    jobs = folder / "jobs"
    jobs.mkdir(parents=True, exist_ok=True, mode=0o700)
    queue = _lock(jobs / "queue.lock")
    try:
        number = 1 + max((int(path.name) for path in _numbered(jobs)), default=0)
        path = jobs / str(number)
        path.mkdir(mode=0o700)
        job = JobFolder(path)
        lock = _lock(path / "lock")
        job.write_order(order)
        job.write_status(
            JobStatus(
                str(number),
                JobState.QUEUED,
                order.title,
                order.mesh,
                submitted=now(),
                request=order.request,
            )
        )
    finally:
        os.close(queue)
    return job, lock
