"""A job that is watched: what it says, line by line as it comes.

Runs on the head for `runner`; each line is one JSON object with the key ``log``, ``event`` or
``status``.
"""

from __future__ import annotations

import contextlib
import json
import select
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

from hpcdeploy.spec.job_folder import EXIT_CANCELLED, JobFolder, JobState, JobStatus, now

LOOK_S = 0.1  # between two looks at files that grow


def follow(job: JobFolder) -> None:
    """Print what the job says and how far it has come, until it has ended; last its status."""
    tails = [
        _Tail(job.log, lambda line: json.dumps({"log": line})),
        _Tail(job.events, lambda line: f'{{"event": {line}}}'),
    ]
    listener = select.poll()
    listener.register(sys.stdout.fileno(), 0)  # tells only that nobody listens any more
    status, is_alive = job.read_status(), True
    while is_alive:
        is_alive = job.is_alive()  # before the last look, which then sees everything
        for tail in tails:
            tail.print_news(is_last=not is_alive)
        status = _look(job, status)
        if is_alive and listener.poll(LOOK_S * 1000.0):
            return
    print_line(json.dumps({"status": asdict(status)}))


def _look(job: JobFolder, before: JobStatus) -> JobStatus:
    """Return where the job stands, also when its cluster goes between two looks."""
    try:
        return job.read_status()
    except FileNotFoundError:
        if before.state.is_over:
            return before
        reason = "its cluster was taken down"
        gone = replace(before, state=JobState.CANCELLED, exit_code=EXIT_CANCELLED)
        return replace(gone, reason=reason, ended=now())


class _Tail:
    """A file that grows."""

    def __init__(self, path: Path, envelop: Callable[[str], str]) -> None:
        self._path = path
        self._envelop = envelop
        self._offset = 0

    def print_news(self, *, is_last: bool) -> None:
        """Print the lines that have come; at the end the unfinished one too."""
        with contextlib.suppress(FileNotFoundError), self._path.open("rb") as stream:
            stream.seek(self._offset)
            news = stream.read()
            if not is_last:
                news = news[: news.rfind(b"\n") + 1]
            self._offset += len(news)
            for line in news.decode("utf-8", "replace").splitlines():
                print_line(self._envelop(line))


def print_line(line: str) -> None:
    """Write a line, given without its end, to whoever asked, at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
