"""Chrome traces: what a viewer reads, whatever became of the job."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hpcapp.timeline import ANY_WORKER, MASTER, Timeline
from hpcapp.trace import open_trace, to_trace
from hpccomponent.clock import ManualClock
from hpccomponent.errors import OutputError


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def timeline(clock: ManualClock) -> Timeline:
    return Timeline(clock.now)


def rows(trace: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    events = trace["traceEvents"]
    names = {
        event["tid"]: event["args"]["name"] for event in events if event["name"] == "thread_name"
    }
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in names.values()}
    for event in events:
        if event["ph"] == "X":
            found[names[event["tid"]]].append(event)
    return found


def test_each_worker_has_a_row_and_times_are_microseconds(
    clock: ManualClock, timeline: Timeline
) -> None:
    clock.advance(4.0)
    timeline.record("fit_tile", "w-1", 1.5, bytes_in=7, bytes_out=9)
    timeline.record("fit_tile", "w-0", 0.5, "lost")
    timeline.record("fit", MASTER, 3.0)
    found = rows(to_trace(timeline))
    assert list(found) == [MASTER, "w-0", "w-1"]
    [event] = found["w-1"]
    assert (event["ts"], event["dur"], event["name"]) == (2.5e6, 1.5e6, "fit_tile")
    assert event["args"] == {"outcome": "done", "bytes_in": 7, "bytes_out": 9}
    assert found["w-0"][0]["cat"] == "lost"


def test_a_worker_does_one_task_at_a_time(clock: ManualClock, timeline: Timeline) -> None:
    clock.advance(4.0)
    timeline.record("fit_tile", "w", 2.0)
    clock.advance(1.0)
    timeline.record("fit_tile", "w", 2.0)  # the answer before was heard of late
    first, second = rows(to_trace(timeline))["w"]
    assert (first["ts"], second["ts"], second["dur"]) == (2e6, 4e6, 1e6)


def test_tasks_of_unknown_workers_do_not_overlap_in_a_row(
    clock: ManualClock, timeline: Timeline
) -> None:
    for _ in range(3):
        clock.advance(1.0)
        timeline.record("fit_tile", ANY_WORKER, 2.0)
    found = rows(to_trace(timeline))
    assert {name: len(events) for name, events in found.items()} == {
        MASTER: 0,
        "worker": 2,
        "worker (2)": 1,
    }


def test_a_job_that_fails_leaves_its_trace(tmp_path: Path, timeline: Timeline) -> None:
    path = tmp_path / "trace.json"

    def fail() -> None:
        with open_trace(path, timeline):
            timeline.record("fit", MASTER, 0.0, "failed")
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        fail()
    assert rows(json.loads(path.read_text()))[MASTER][0]["cat"] == "failed"


def test_a_place_that_cannot_be_written_is_told_first(tmp_path: Path, timeline: Timeline) -> None:
    with pytest.raises(OutputError, match="--trace"), open_trace(tmp_path, timeline):
        raise AssertionError("the block must not run")
