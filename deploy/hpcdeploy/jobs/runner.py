"""The head's side of jobs: ``python -P -m hpcdeploy.jobs.runner --folder FOLDER COMMAND``.

::

    user's machine ── SSH ──> start ── a session of its own ──> run ──> hpcapp VERB --cluster ...
                        list, follow, log, cancel, end           │
                              │ read                             │ writes
                              └──────> jobs/N/ <─────────────────┘

Each command is one process that answers in lines of JSON and ends; `run` alone stays, so that a
job outlives whoever submitted it. Jobs run one after the other, in the order of their numbers:
`run` waits until the locks of all earlier ones are free. No state is kept anywhere else.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import NoReturn

from hpccomponent.errors import HpcError, JobError, UsageError
from hpccomponent.runtime.lifetime import die_with_parent
from hpcdeploy.jobs.tail import follow, print_line
from hpcdeploy.spec.job_folder import (
    EXIT_CANCELLED,
    JobFolder,
    JobOrder,
    JobState,
    JobStatus,
    all_jobs,
    create_job,
    now,
)

LEAVE_S = 5.0  # for the verb to end in order after SIGTERM
KILL_S = 10.0  # for the runner itself; longer than the verb gets
LOOK_S = 0.1  # between two looks at a job that ends


class _Cancelled(BaseException):
    """The runner was told to end."""


def start(folder: Path, order: JobOrder) -> JobStatus:
    """Put a job into the queue, and leave a runner behind that sees to it."""
    job, lock = create_job(folder, order)
    try:
        with job.log.open("ab") as log:
            runner = subprocess.Popen(  # noqa: S603 - our own interpreter
                [sys.executable, "-P", "-m", "hpcdeploy.jobs.runner", "--folder", str(folder),
                 "run", job.path.name, "--lock-fd", str(lock)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=log,
                pass_fds=(lock,),
                start_new_session=True,
            )  # fmt: skip
        runner.returncode = 0  # it outlives this process, and is not waited for
    finally:
        os.close(lock)
    return job.read_status()


def run(folder: Path, job: JobFolder, lock: int) -> None:
    """Wait for the job's turn, run its verb, and write down how it ended.

    `lock` is the descriptor that holds the job's lock; the verb inherits it.
    """
    signal.signal(signal.SIGTERM, _cancel)
    signal.signal(signal.SIGINT, _cancel)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    status = replace(job.read_status(), runner=os.getpid())
    try:
        job.write_status(status)
        _wait_for_turn(folder, job)
        status = replace(status, state=JobState.RUNNING, started=now())
        job.write_status(status)
        status = _finish(job, status, _run_verb(folder, job, lock))
    except _Cancelled:
        status = replace(status, state=JobState.CANCELLED, exit_code=EXIT_CANCELLED)
    except (HpcError, OSError) as error:
        code = getattr(error, "exit_code", 1)
        status = replace(status, state=JobState.FAILED, exit_code=code, reason=str(error))
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    job.write_status(replace(status, ended=now()))


def _cancel(signum: int, frame: FrameType | None) -> NoReturn:
    del signum, frame
    raise _Cancelled


def _wait_for_turn(folder: Path, job: JobFolder) -> None:
    for earlier in all_jobs(folder):
        if int(earlier.path.name) < int(job.path.name) and earlier.is_alive():
            _say(f"waiting for job {earlier.path.name}")
            earlier.wait_for_end()


def _run_verb(folder: Path, job: JobFolder, lock: int) -> int:
    """Run the verb to its end; return its exit code, negative for a signal."""
    order = job.read_order()
    points = folder / order.points
    if order.points_url:
        from hpcdeploy.jobs.bucket_client import fetch_points

        fetch_points(order, points, _say)
    command = [
        sys.executable, "-P", "-m", "hpcapp", order.verb, "-o", order.mesh, *order.options,
        "--cluster", str(folder / "inventory.json"), "--events", str(job.events), "--json",
        "--", job.link_points(points),
    ]  # fmt: skip
    runner = os.getpid()
    with job.report.open("wb") as report:
        process = subprocess.Popen(  # noqa: S603 - the verb and its options are the user's own
            command,
            cwd=job.path,  # it calls its files what the user calls them
            stdin=subprocess.DEVNULL,
            stdout=report,
            pass_fds=(lock,),  # the job lives as long as it does
            preexec_fn=lambda: die_with_parent(runner, signal.SIGTERM),
        )
        try:
            return process.wait()
        except _Cancelled:
            _end(process)
            raise


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the verb, in order if it will."""
    process.terminate()
    try:
        process.wait(LEAVE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _finish(job: JobFolder, status: JobStatus, code: int) -> JobStatus:
    if code < 0:
        reason = f"killed by {signal.Signals(-code).name}"
        return replace(status, state=JobState.FAILED, exit_code=1, reason=reason)
    if code > 0:
        lines = job.log.read_text(encoding="utf-8", errors="replace").splitlines()
        last = next((line for line in reversed(lines) if line.strip()), "")
        reason = last.removeprefix("hpcapp: ")
        return replace(status, state=JobState.FAILED, exit_code=code, reason=reason)
    order = job.read_order()
    status = replace(status, state=JobState.DONE, exit_code=0)
    if order.mesh_url:
        from hpcdeploy.jobs.bucket_client import send_mesh

        digest = send_mesh(order, job.path / order.mesh, _say)
        status = replace(status, mesh_key=order.mesh_key, mesh_sha256=digest)
    return status


def cancel(job: JobFolder) -> JobStatus:
    """End a job that waits or runs, and return its status when it is gone."""
    status = job.read_status()
    deadline = time.monotonic() + KILL_S
    while job.is_alive() and not status.runner and time.monotonic() < deadline:
        time.sleep(LOOK_S)  # its runner is just coming up
        status = job.read_status()
    steps = ((os.kill, signal.SIGTERM), (os.killpg, signal.SIGKILL))
    for send, number in steps:  # the runner ends its verb in order; else all end at once
        if not job.is_alive() or not status.runner:
            break
        with contextlib.suppress(ProcessLookupError):
            send(status.runner, number)
        deadline = time.monotonic() + KILL_S
        while job.is_alive() and time.monotonic() < deadline:
            time.sleep(LOOK_S)
    return job.read_status()


def _say(line: str) -> None:
    with contextlib.suppress(OSError):
        sys.stderr.write(line + "\n")
        sys.stderr.flush()


def _find_job(folder: Path, number: str) -> JobFolder:
    job = JobFolder(folder / "jobs" / number)
    if not number.isdigit() or not job.path.is_dir():
        raise UsageError(f"there is no job {number!r}", "see 'hpcapp jobs'")
    return job


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m hpcdeploy.jobs.runner")
    parser.add_argument("--folder", type=Path, required=True)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("start", help="read an order from stdin, print the job's status")
    commands.add_parser("list", help="print a status a line")
    commands.add_parser("end", help="cancel all jobs")
    for name in ("follow", "log", "cancel", "run"):
        command = commands.add_parser(name)
        command.add_argument("job")
        if name == "run":
            command.add_argument("--lock-fd", type=int, required=True)
    return parser.parse_args(words)


def main(words: Sequence[str] | None = None) -> int:
    """Carry out one command, by default the command line's; return the exit code."""
    arguments = _arguments(words)
    try:
        for line in _answer(arguments):
            print_line(line)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # whoever asked is gone
    except HpcError as error:
        _say(str(error))
        return error.exit_code
    except OSError as error:
        named = f"{error.filename}: " if error.filename else ""  # whoever reads it names the node
        _say(f"{named}{error.strerror or error}")
        return 1
    return 0


def _read_order(text: bytes) -> JobOrder:
    try:
        return JobOrder.from_json(text)
    except ValueError as error:
        raise UsageError(f"no order of a job ({error})", "run hpcapp up again") from None


def _answer(arguments: argparse.Namespace) -> Iterator[str]:
    """Carry out a command; yield the lines of its answer."""
    folder: Path = arguments.folder.absolute()
    match arguments.command:
        case "start":
            yield start(folder, _read_order(sys.stdin.buffer.read())).to_json()
        case "list":
            yield from (job.read_status().to_json() for job in all_jobs(folder))
        case "end":  # the last first, so that none has its turn meanwhile
            jobs = [job for job in reversed(all_jobs(folder)) if job.is_alive()]
            for job in jobs:
                yield cancel(job).to_json()
            if alive_jobs := [job.path.name for job in jobs if job.is_alive()]:
                raise JobError(f"job {', '.join(alive_jobs)} does not end")
        case "follow":
            follow(_find_job(folder, arguments.job))
        case "log":
            log = _find_job(folder, arguments.job).log
            yield from log.read_text(encoding="utf-8", errors="replace").splitlines()
        case "cancel":
            yield cancel(_find_job(folder, arguments.job)).to_json()
        case "run":
            run(folder, _find_job(folder, arguments.job), arguments.lock_fd)


if __name__ == "__main__":
    sys.exit(main())
