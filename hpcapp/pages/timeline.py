"""Spans of a job as a picture: a row for each worker, a bar for each task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from hpcapp.pages.report import TaskSpan

__all__ = ["draw_timeline"]

_WIDTH, _LEFT, _ROW = 380, 86, 15
_TICKS = 4
_COLOURS = (
    "#4878cf",
    "#6acc65",
    "#b47cc7",
    "#c4ad66",
    "#77bedb",
    "#d5875c",
    "#8c8c8c",
    "#2f4b7c",
    "#2e8b57",
    "#7a5195",
    "#a05d56",
    "#c9a0dc",
    "#5f9ea0",
    "#b0c4de",
    "#6b8e23",
)
_FAILED = {"lost": "#c0392b", "failed": "#c0392b", "refused": "#c0392b", "repeated": "#e0a030"}
_MOST_BARS = 4000  # more cannot be told apart, and make the page slow
_MOST_ROWS = 64
MASTER = "master"


def draw_timeline(spans: Sequence[TaskSpan]) -> str:
    """Draw spans as SVG in HTML, with a legend; nothing where there are no spans.

    Parameters
    ----------
    spans : sequence of mapping
        Of very many the longest are drawn.
    """
    if not spans:
        return ""
    end = max(span.end for span in spans) or 1e-9
    workers = sorted({span.worker for span in spans}, key=_order)
    names: dict[str, int] = {}
    for span in spans:
        names.setdefault(span.name, len(names))
    rows = {worker: number for number, worker in enumerate(workers[:_MOST_ROWS])}
    height = _ROW * len(rows) + 18
    drawn = sorted(spans, key=lambda span: span.begin - span.end)[:_MOST_BARS]
    parts = [f'<svg class="timeline" viewBox="0 0 {_WIDTH} {height}" role="img">']
    parts += [_tick(end, number, height) for number in range(_TICKS + 1)]
    for worker, row in rows.items():
        short = worker if len(worker) <= 14 else f"{worker[:13]}…"
        parts.append(f'<text x="0" y="{_ROW * row + 11}">{escape(short)}</text>')
    parts += [_bar(span, rows, names, end) for span in drawn if span.worker in rows]
    parts.append("</svg>")
    notes = []
    if len(drawn) < len(spans):
        notes.append(f"the longest {len(drawn)} of {len(spans)} spans")
    if len(rows) < len(workers):
        notes.append(f"{len(rows)} of {len(workers)} workers")
    note = f"<p>Drawn are {' and '.join(notes)}.</p>" if notes else ""
    return "\n".join(parts) + _legend(names, spans) + note


def _order(worker: str) -> tuple[bool, int, str]:
    """Sort the master first, and worker-2 before worker-10."""
    return worker != MASTER, len(worker), worker


def _at(seconds: float, end: float) -> float:
    return _LEFT + (_WIDTH - _LEFT - 4) * seconds / end


def _tick(end: float, number: int, height: int) -> str:
    seconds = end * number / _TICKS
    x = _at(seconds, end)
    anchor = "end" if number == _TICKS else "middle"
    return (
        f'<line class="axis" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height - 14}"/>'
        f'<text x="{x:.1f}" y="{height - 3}" text-anchor="{anchor}">{seconds:.3g} s</text>'
    )


def _colour(name: str, names: Mapping[str, int], outcome: str) -> str:
    return _FAILED.get(outcome) or _COLOURS[names[name] % len(_COLOURS)]


def _bar(span: TaskSpan, rows: Mapping[str, int], names: Mapping[str, int], end: float) -> str:
    outcome = "" if span.outcome == "done" else f", {span.outcome}"
    seconds = span.end - span.begin
    text = escape(f"{span.name}: {seconds:.3g} s from {span.begin:.3g} s{outcome}")
    left, right = _at(span.begin, end), _at(span.end, end)
    return (
        f'<rect x="{left:.2f}" y="{_ROW * rows[span.worker] + 2}" '
        f'width="{max(right - left, 0.4):.2f}" height="{_ROW - 4}" '
        f'fill="{_colour(span.name, names, span.outcome)}"><title>{text}</title></rect>'
    )


def _legend(names: Mapping[str, int], spans: Sequence[TaskSpan]) -> str:
    """Name the bars, the longest first, and what has failed."""
    seconds = dict.fromkeys(names, 0.0)
    for span in spans:
        seconds[span.name] += span.end - span.begin
    rows = [
        f'<tr><th><svg width="10" height="10"><rect width="10" height="10" '
        f'fill="{_colour(name, names, "done")}"/></svg> {escape(name)}</th>'
        f'<td class="number">{total:.2f} s</td></tr>'
        for name, total in sorted(seconds.items(), key=lambda item: -item[1])[:_MOST_ROWS]
    ]
    return "\n<table>\n" + "\n".join(rows) + "\n</table>"
