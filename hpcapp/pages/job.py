"""What a job's report says, as sections of a page."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence

from hpcapp.pages.page import Section, tabulate
from hpcapp.pages.report import TaskSpan
from hpcapp.pages.timeline import MASTER, draw_timeline
from hpcapp.wording import say_name, say_number, say_share, say_value
from hpccomponent.cli.terminal import visible_text
from hpccomponent.foreign_json import convert

_LENGTHS = {"cell_size", "coarsest_step", "farthest", "fill_holes", "handle_width", "noise",
            "reach", "spacing", "spacing_range", "step", "trim"}  # fmt: skip
_SHARES = {"certainty", "closure_certainty", "probability", "share", "sure", "unsupported"}
_MESH = ("vertices", "faces", "watertight", "edge_manifold", "vertex_manifold", "components",
         "genus", "attributes")  # fmt: skip
_SUPPORT = ("share", "farthest")
_WORK = ("backend", "workers", "policy", "kernels")
_ELSEWHERE = (*_MESH, *_WORK, "summary", "support", "input", "normals", "reading", "dropped",
              "warnings", "stages", "timeline", "owners", "choice", "bytes_sent", "bytes_received",
              "command", "cost", "losses", "verification")  # fmt: skip
_FAILED = ("lost", "failed", "refused", "repeated")


def describe_job(
    report: Mapping[str, object], marked: Sequence[str] = (), *, has_mesh: bool = True
) -> list[Section]:
    """Return what a job found, decided and did, and what its mesh is, if it has one.

    A report has JSON values; see ``docs/reference/reconstruct.md``. What it lacks is left out;
    names not known here stand among the decisions. Texts of the scene's markers are marked.
    """
    others = convert(report.get("warnings") or [], list[str])
    sections = [
        Section("Warnings", "warnings.html", {"marked": marked, "others": others}),
        tabulate("Decided", _decisions(report)),
        *_describe_input(report),
    ]
    if has_mesh:
        sections.insert(0, tabulate("Mesh", _mesh(report)))
    if drawn := draw_timeline(_spans(report) or _stages(report)):
        sections.append(Section("Time", "timeline.html", drawn))
    sections.append(tabulate("Workers and traffic", _work(report)))
    if command := report.get("command"):
        words = command if isinstance(command, str) else shlex.join(convert(command, list[str]))
        again = {"command": visible_text(words)}
        sections.append(Section("To do it again", "command.html", again))
    return sections


def find_unit(report: Mapping[str, object]) -> str:
    """Return the unit of a report's lengths; nothing where it is not known."""
    given = report.get("input")
    unit = given.get("unit") if isinstance(given, Mapping) else None
    return unit if isinstance(unit, str) and unit != "degree" else ""


def _readable(value: object, name: str = "", unit: str = "") -> object:
    """Return a JSON value as a cell shows it."""
    if isinstance(value, Mapping):
        said = (
            f"{say_name(str(k))} {say_value(_readable(v, str(k), unit))}" for k, v in value.items()
        )
        return ", ".join(said) or "-"
    if isinstance(value, list | tuple):
        return ", ".join(say_value(_readable(item, name, unit)) for item in value) or "none"
    if isinstance(value, int | float) and not isinstance(value, bool):
        if name in _LENGTHS:
            return say_number(float(value), unit)
        if name in _SHARES and 0 <= value <= 1:
            return say_share(float(value))
    return "-" if value is None else value


def _pick(report: Mapping[str, object], names: Iterable[str]) -> dict[str, object]:
    unit = find_unit(report)
    return {say_name(name): _readable(report[name], name, unit) for name in names if name in report}


def _mesh(report: Mapping[str, object]) -> dict[str, object]:
    """Return what the mesh is, and how much of it the points support."""
    rows = _pick(report, _MESH)
    if isinstance(support := report.get("support"), Mapping):
        unit = find_unit(report)
        rows |= {say_name(name): _readable(support[name], name, unit)
                 for name in _SUPPORT if name in support}  # fmt: skip
    return rows


def _decisions(report: Mapping[str, object]) -> dict[str, object]:
    """Return what was chosen and found on the way to the mesh."""
    rows = _pick(report, (name for name in report if name not in _ELSEWHERE))
    if isinstance(normals := report.get("normals"), Mapping):
        rows |= {f"normals: {say_name(name)}": _readable(v, name) for name, v in normals.items()}
    if isinstance(reading := report.get("reading"), Mapping):
        rows |= _describe_reading(reading)
    if isinstance(dropped := report.get("dropped"), Mapping):
        rows |= {f"dropped: {say_name(name)}": _readable(v) for name, v in dropped.items()}
    return rows


def _describe_reading(reading: Mapping[str, object]) -> dict[str, object]:
    """Return what the scan is of, and what else it may be, and why."""
    told = {
        name: "; ".join(
            ", ".join(say_value(_readable(v, k)) for k, v in one.items() if v != "")
            for one in convert(reading.get(name) or [], list[dict[str, object]])
        )
        or "none"
        for name in ("rivals", "because")
    }
    rows = {say_name(name): _readable(v, name) for name, v in {**reading, **told}.items()}
    return {f"reading: {name}": value for name, value in rows.items()}


def _describe_input(report: Mapping[str, object]) -> list[Section]:
    given = report.get("input")
    if not isinstance(given, Mapping):
        return []
    rows = {say_name(name): _readable(v) for name, v in given.items() if name != "columns"}
    columns = given.get("columns")
    if isinstance(columns, Mapping):
        by_use: dict[str, list[str]] = {}
        for name, use in columns.items():
            by_use.setdefault(str(use), []).append(str(name))
        rows |= {f"taken as {use}": ", ".join(names) for use, names in by_use.items()}
    return [tabulate("Input", rows)]


def _stages(report: Mapping[str, object]) -> list[TaskSpan]:
    """Return the stages of a job one after the other, for where there are no spans."""
    spans, begin = [], 0.0
    for name, seconds in convert(report.get("stages") or {}, dict[str, float]).items():
        spans.append(TaskSpan(name, MASTER, begin, begin + seconds))
        begin += seconds
    return spans


def _spans(report: Mapping[str, object]) -> list[TaskSpan]:
    timeline = report.get("timeline")
    spans = timeline.get("spans") if isinstance(timeline, Mapping) else None
    return convert(spans or [], list[TaskSpan])


def _work(report: Mapping[str, object]) -> dict[str, object]:
    """Return who did the work, what travelled, what failed and what it cost."""
    rows = _pick(report, _WORK)
    if isinstance(choice := report.get("choice"), Mapping) and "reason" in choice:
        rows["why these"] = choice["reason"]
    for name in ("bytes_sent", "bytes_received"):
        if name in report:
            rows[say_name(name)] = report[name]
    spans = _spans(report)
    for outcome in _FAILED:
        if spans:
            rows[f"tasks {outcome}"] = sum(span.outcome == outcome for span in spans)
    for name in ("verification", "losses", "cost"):
        if name in report:
            rows[name] = _readable(report[name])
    return rows
