"""A job's report before a page says it: anybody may have written it, and it may be another's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError
from hpccomponent.files.paths import read_regular
from hpccomponent.foreign_json import convert, decode

Seconds = Annotated[float, Meta(ge=0.0, le=1e12)]
_DEEPEST = 16  # of values in values
_ADVICE = "give what --json has printed"


@dataclass(frozen=True, slots=True)
class TaskSpan:
    """A span of a report's timeline, in seconds since the job's start."""

    name: str
    worker: str
    begin: Seconds
    end: Seconds
    outcome: str = "done"


@dataclass(frozen=True, slots=True)
class _Timeline:
    spans: list[TaskSpan]


@dataclass(frozen=True, slots=True)
class _Known:
    """The entries that pages compute with, and what they may be; others are said as they are."""

    summary: str = ""
    command: str | list[str] | None = None
    warnings: list[str] | None = None
    stages: dict[str, Seconds] | None = None
    timeline: _Timeline | None = None
    spacing: Annotated[float, Meta(ge=0.0, le=1e300)] | None = None


def read_report(path: Path) -> dict[str, object]:
    """Read from a file what ``reconstruct --json`` has printed, and check it.

    Raise InputError where it cannot be read, or is no report.
    """
    try:
        report = decode(read_regular(path), dict[str, object])
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}", _ADVICE) from None
    except ValueError as error:
        raise InputError(f"{path}: is no report ({error})", _ADVICE) from None
    check_report(report, str(path))
    return report


def check_report(report: Mapping[str, object], source: str) -> None:
    """Refuse a report that a page cannot say.

    Raise InputError where an entry is not what it is in reports, or values are nested too deeply.
    """
    try:
        convert(report, _Known)
        _check_depth(report)
    except ValueError as error:
        raise InputError(f"{source}: is no report of a job ({error})", _ADVICE) from None


def _check_depth(report: Mapping[str, object]) -> None:
    level: list[Mapping[str, object] | Sequence[object]] = [report]
    for _ in range(_DEEPEST):
        inside = [value.values() if isinstance(value, Mapping) else value for value in level]
        level = [v for values in inside for v in values if isinstance(v, Mapping | list | tuple)]
        if not level:
            return
    raise ValueError("it is nested too deeply")
