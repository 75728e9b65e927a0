"""What is new of a job, for one page: each reads at its own pace, and nothing is kept for it."""

from __future__ import annotations

from dataclasses import astuple

from hpcapp.dashboard.watched_job import WatchedJob

MOST_SPANS = 2000  # at once


class Reader:
    """Remembers what a page has been told."""

    def __init__(self, job: WatchedJob) -> None:
        self._job = job
        self._spans = 0
        self._line = 0
        self._is_first = True

    def look(self) -> dict[str, object]:
        """Return what is new, as JSON values.

        ``first``: whether the page is to forget what it has; ``more``: whether to look again at
        once; ``now``, ``state``, ``stage``, ``workers``, ``parts`` (how many can be asked for) and
        ``uncounted`` (how many cannot) as they are; ``spans`` and ``lines`` since the last look.
        """
        job = self._job
        spans = job.timeline.spans[self._spans : self._spans + MOST_SPANS]
        self._spans += len(spans)
        lines = [(number, line) for number, line in list(job.lines) if number > self._line]
        self._line = max([number for number, _ in lines], default=self._line)
        is_first, self._is_first = self._is_first, False
        stage, shown = job.stage, len(job.loads)
        return {
            "first": is_first,
            "more": len(spans) == MOST_SPANS,
            "now": job.timeline.now(),
            "state": job.state,
            "stage": None if stage is None else astuple(stage),
            "workers": [astuple(worker) for worker in job.timeline.list_workers()],
            "parts": shown,
            "uncounted": job.parts - shown,
            "spans": [astuple(span) for span in spans],
            "lines": [line for _, line in lines],
        }
