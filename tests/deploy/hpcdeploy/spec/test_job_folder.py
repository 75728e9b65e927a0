"""What a job's status says of its time, its cost and its command."""

from __future__ import annotations

import json
import os
import shlex
from datetime import UTC, datetime
from pathlib import Path

import pytest

from hpcdeploy.spec.job_folder import (
    JobOrder,
    JobRequest,
    JobState,
    JobStatus,
    create_job,
)

NOON = datetime(2026, 1, 1, 12, tzinfo=UTC)
BEGUN, ENDED = "2026-01-01T11:30:00+00:00", "2026-01-01T11:45:00+00:00"
TWO_DOLLARS = JobRequest(("submit",), "/", 2.0)
ORDER = {"verb": "reconstruct", "points": "points/x.ply", "mesh": "mesh.ply"}
ASKED = {"words": ["submit"], "folder": "/", "hourly_cost": 2.0}


@pytest.mark.parametrize(
    ("status", "seconds", "cost"),
    [
        (JobStatus("1", JobState.DONE, started=BEGUN, ended=ENDED), 900.0, 0.5),
        (JobStatus("1", JobState.RUNNING, started=BEGUN), 1800.0, 1.0),
        (JobStatus("1", JobState.RUNNING, started="2026-01-01T12:00:03+00:00"), 0.0, 0.0),
        (JobStatus("1", JobState.QUEUED), None, None),
        (JobStatus("1", JobState.CANCELLED, ended=ENDED), None, None),
        (JobStatus("1", JobState.FAILED, started=BEGUN), None, None),  # its runner was killed
    ],
)
def test_a_job_costs_the_clusters_price_while_it_runs(
    status: JobStatus, seconds: float | None, cost: float | None
) -> None:
    told = JobStatus.from_json(status.to_json())
    assert told == status
    assert (told.seconds(NOON), told.cost(NOON)) == (seconds, None)
    priced = json.loads(status.to_json()) | {"request": {"hourly_cost": 2.0}}
    assert JobStatus.from_json(json.dumps(priced)).cost(NOON) == cost


def test_the_head_remembers_what_was_typed(tmp_path: Path) -> None:
    order = JobOrder("reconstruct", "points/x.ply", "mesh.ply", request=TWO_DOLLARS)
    job, lock = create_job(tmp_path, JobOrder.from_json(json.dumps({**ORDER, "request": ASKED})))
    os.close(lock)
    assert job.read_order() == order
    told = JobStatus.from_json((job.path / "status.json").read_bytes())
    assert told.request == TWO_DOLLARS


def test_whatever_words_a_head_tells_a_command_is_one_of_hpcapp() -> None:
    words = ("$(reboot)", "; rm -rf ~", "a'b", "\n", "")
    for folder in ("/home/me", "/x; reboot"):
        command = JobRequest(words, "/x; reboot").command(folder)
        begin = [] if folder == "/x; reboot" else ["cd", "/x; reboot", "&&"]
        assert shlex.split(command) == [*begin, "hpcapp", *words]
    assert JobRequest().command("/") == ""


@pytest.mark.parametrize("lie", [{"hourly_cost": -1}, {"hourly_cost": "x"}, {"words": "submit"}])
def test_what_is_no_request_is_no_status(lie: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="request"):
        JobStatus.from_json(json.dumps({"job": "1", "state": "done", "request": lie}))
