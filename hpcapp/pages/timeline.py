"""Spans of a job as a picture: a row for each worker, a bar for each task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hpcapp.pages.report import TaskSpan
from hpcapp.wording import round_ticks, say_number

_WIDTH, _LEFT, _ROW = 380, 86, 15
_TICKS = 4  # at most
_SERIES = 12  # colours of the design
_FAILED = {"lost", "failed", "refused"}
_MOST_BARS = 4000  # more cannot be told apart, and make the page slow
_MOST_ROWS = 64
MASTER = "master"


def draw_timeline(spans: Sequence[TaskSpan]) -> dict[str, object]:
    """Return what ``timeline.html`` draws: an SVG with a legend; nothing without spans.

    Of very many spans the longest are drawn.
    """
    if not spans:
        return {}
    end = max(span.end for span in spans) or 1e-9
    workers = sorted({span.worker for span in spans}, key=_order)
    names: dict[str, int] = {}
    for span in spans:
        names.setdefault(span.name, len(names))
    rows = {worker: number for number, worker in enumerate(workers[:_MOST_ROWS])}
    drawn = sorted(spans, key=lambda span: span.begin - span.end)[:_MOST_BARS]
    notes = []
    if len(drawn) < len(spans):
        notes.append(f"the longest {len(drawn):,} of {len(spans):,} spans")
    if len(rows) < len(workers):
        notes.append(f"{len(rows)} of {len(workers)} workers")
    return {
        "width": _WIDTH,
        "height": _ROW * len(rows) + 18,
        "row": _ROW,
        "ticks": [_tick(seconds, end) for seconds in round_ticks(end, _TICKS)],
        "workers": list(rows),
        "bars": [_bar(span, rows, names, end) for span in drawn if span.worker in rows],
        "legend": _legend(names, spans),
        "notes": notes,
    }


def _order(worker: str) -> tuple[bool, int, str]:
    """Sort the master first, and worker-2 before worker-10."""
    return worker != MASTER, len(worker), worker


def _at(seconds: float, end: float) -> float:
    return _LEFT + (_WIDTH - _LEFT - 4) * seconds / end


def _tick(seconds: float, end: float) -> dict[str, object]:
    x = _at(seconds, end)
    return {"x": x, "seconds": seconds, "anchor": "end" if x > _WIDTH - _ROW else "middle"}


def _colour(name: str, names: Mapping[str, int], outcome: str) -> str:
    """Return the design's name of a colour."""
    if outcome in _FAILED:
        return "--failed"
    return "--warn" if outcome == "repeated" else f"--series-{names[name] % _SERIES + 1}"


def _bar(
    span: TaskSpan, rows: Mapping[str, int], names: Mapping[str, int], end: float
) -> dict[str, object]:
    outcome = "" if span.outcome == "done" else f", {span.outcome}"
    seconds = span.end - span.begin
    left, right = _at(span.begin, end), _at(span.end, end)
    return {
        "x": left,
        "width": max(right - left, 0.4),
        "row": rows[span.worker],
        "colour": _colour(span.name, names, span.outcome),
        "text": f"{span.name}: {say_number(seconds, 's')} from {say_number(span.begin, 's')}"
        f"{outcome}",
    }


def _legend(names: Mapping[str, int], spans: Sequence[TaskSpan]) -> list[dict[str, object]]:
    """Name the bars, the longest first."""
    seconds = dict.fromkeys(names, 0.0)
    for span in spans:
        seconds[span.name] += span.end - span.begin
    longest = sorted(seconds.items(), key=lambda item: -item[1])[:_MOST_ROWS]
    return [
        {"name": name, "seconds": total, "colour": _colour(name, names, "done")}
        for name, total in longest
    ]
