"""Spans of a job as a picture: a row for each worker, a bar for each task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from hpcapp.pages.report import TaskSpan
from hpcapp.wording import round_ticks, say_number

_WIDTH, _LEFT, _ROW = 380, 86, 15
_TICKS = 4  # at most
_SERIES = 12  # colours of the design
_FAILED = {"lost", "failed", "refused"}
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
    parts += [_tick(seconds, end, height) for seconds in round_ticks(end, _TICKS)]
    for worker, row in rows.items():
        short = worker if len(worker) <= 14 else f"{worker[:13]}…"
        parts.append(f'<text x="0" y="{_ROW * row + 11}">{escape(short)}</text>')
    parts += [_bar(span, rows, names, end) for span in drawn if span.worker in rows]
    parts.append("</svg>")
    notes = []
    if len(drawn) < len(spans):
        notes.append(f"the longest {len(drawn):,} of {len(spans):,} spans")
    if len(rows) < len(workers):
        notes.append(f"{len(rows)} of {len(workers)} workers")
    note = f"<p>Drawn are {' and '.join(notes)}.</p>" if notes else ""
    return "\n".join(parts) + _legend(names, spans) + note


def _order(worker: str) -> tuple[bool, int, str]:
    """Sort the master first, and worker-2 before worker-10."""
    return worker != MASTER, len(worker), worker


def _at(seconds: float, end: float) -> float:
    return _LEFT + (_WIDTH - _LEFT - 4) * seconds / end


def _tick(seconds: float, end: float, height: int) -> str:
    x = _at(seconds, end)
    anchor = "end" if x > _WIDTH - _ROW else "middle"
    return (
        f'<line class="axis" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height - 14}"/>'
        f'<text x="{x:.1f}" y="{height - 3}" text-anchor="{anchor}">{seconds:g} s</text>'
    )


def _colour(name: str, names: Mapping[str, int], outcome: str) -> str:
    if outcome in _FAILED:
        return "var(--failed)"
    return "var(--warn)" if outcome == "repeated" else f"var(--series-{names[name] % _SERIES + 1})"


def _bar(span: TaskSpan, rows: Mapping[str, int], names: Mapping[str, int], end: float) -> str:
    outcome = "" if span.outcome == "done" else f", {span.outcome}"
    seconds = span.end - span.begin
    text = escape(
        f"{span.name}: {say_number(seconds, 's')} from {say_number(span.begin, 's')}{outcome}"
    )
    left, right = _at(span.begin, end), _at(span.end, end)
    return (
        f'<rect x="{left:.2f}" y="{_ROW * rows[span.worker] + 2}" '
        f'width="{max(right - left, 0.4):.2f}" height="{_ROW - 4}" '
        f'style="fill:{_colour(span.name, names, span.outcome)}"><title>{text}</title></rect>'
    )


def _legend(names: Mapping[str, int], spans: Sequence[TaskSpan]) -> str:
    """Name the bars, the longest first, and what has failed."""
    seconds = dict.fromkeys(names, 0.0)
    for span in spans:
        seconds[span.name] += span.end - span.begin
    rows = [
        f'<tr><th><svg width="10" height="10"><rect width="10" height="10" '
        f'style="fill:{_colour(name, names, "done")}"/></svg> {escape(name)}</th>'
        f'<td class="number">{say_number(total, "s")}</td></tr>'
        for name, total in sorted(seconds.items(), key=lambda item: -item[1])[:_MOST_ROWS]
    ]
    return "\n<table>\n" + "\n".join(rows) + "\n</table>"
