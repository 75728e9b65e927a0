"""A job's timeline as a Chrome trace, for chrome://tracing and https://ui.perfetto.dev."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

from hpcapp.timeline import ANY_WORKER, MASTER, Span, Timeline
from hpccomponent.errors import OutputError
from hpccomponent.files.private_files import open_if_read

_PROCESS = 1  # the job: all rows belong to it
_MICROSECONDS = 1e6


@contextmanager
def open_trace(path: Path | None, timeline: Timeline) -> Iterator[None]:
    """Write the trace of a job to a file when the block ends, even if by an error.

    Raise OutputError where it cannot be written; before the block where that shows by then.
    """
    if path is None:
        yield
        return
    with _translated(path):
        stream = open(path, "w", encoding="utf-8", opener=open_if_read)  # noqa: SIM115
    with closing(stream):
        try:
            yield
        finally:
            with _translated(path):
                json.dump(to_trace(timeline), stream)
                stream.flush()


@contextmanager
def _translated(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror})", "give another --trace"
        ) from error


def to_trace(timeline: Timeline) -> dict[str, object]:
    """Return a timeline in the Trace Event Format, as JSON values.

    Each span is a complete event ("X"), in microseconds; the master is the first row, each worker
    has one of its own; tasks of workers that are not known share as many as they need.

    References
    ----------
    https://docs.google.com/document/d/1CvAClvFfyA5R-PhYUmn5OOQtYMH4h6I0nSsKchNAySU
    """
    events: list[dict[str, object]] = [
        {"ph": "M", "pid": _PROCESS, "name": "process_name", "args": {"name": "hpcapp"}}
    ]
    for row, (name, spans) in enumerate(_rows(list(timeline.spans))):
        head = {"ph": "M", "pid": _PROCESS, "tid": row}
        events.append(head | {"name": "thread_name", "args": {"name": name}})
        events.append(head | {"name": "thread_sort_index", "args": {"sort_index": row}})
        events += [_event(span, row) for span in spans]
    return {"traceEvents": events, "displayTimeUnit": "ms"}


def _rows(spans: list[Span]) -> Iterator[tuple[str, list[Span]]]:
    """Yield the rows: a viewer takes spans of one row for calls, one within the other."""
    stages = [span for span in spans if span.worker == MASTER]
    yield MASTER, sorted(stages, key=lambda span: (span.begin, -span.end))
    workers: dict[str, list[Span]] = {}
    for span in spans:
        if span.worker != MASTER:
            workers.setdefault(span.worker, []).append(span)
    for worker, tasks in sorted(workers.items()):
        if worker != ANY_WORKER:
            yield worker, list(_in_turn(tasks))
            continue
        for number, lane in enumerate(_lanes(tasks)):
            yield (worker if not number else f"{worker} ({number + 1})"), lane


def _in_turn(tasks: list[Span]) -> Iterator[Span]:
    """Yield the tasks of a worker, which does one at a time, without overlap.

    Ends are when the master heard of them: where it heard late, the next seems to begin too early.
    """
    last = 0.0
    for span in sorted(tasks, key=lambda span: span.end):
        yield replace(span, begin=min(span.end, max(span.begin, last)))
        last = span.end


def _lanes(tasks: list[Span]) -> list[list[Span]]:
    """Part tasks of workers that are not known into rows without overlap."""
    lanes: list[list[Span]] = []
    for span in sorted(tasks, key=lambda span: (span.begin, span.end)):
        lane = next((lane for lane in lanes if lane[-1].end <= span.begin), None)
        if lane is None:
            lane = []
            lanes.append(lane)
        lane.append(span)
    return lanes


def _event(span: Span, row: int) -> dict[str, object]:
    return {
        "ph": "X",
        "pid": _PROCESS,
        "tid": row,
        "name": span.name,
        "cat": span.outcome,
        "ts": round(span.begin * _MICROSECONDS, 1),
        "dur": round((span.end - span.begin) * _MICROSECONDS, 1),
        "args": {
            "outcome": span.outcome,
            "bytes_in": span.bytes_in,
            "bytes_out": span.bytes_out,
        },
    }
