"""A job's timeline holds every stage and every task of each backend."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.backends.selection import open_executor
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpcapp.progress import Progress, StageClock
from hpcapp.timeline import ANY_WORKER, MASTER, Timeline
from hpcapp.workforce import map_batches
from hpccomponent.runtime.visible_files import sees_files


def test_a_span_never_begins_before_the_job() -> None:
    timeline = Timeline(iter([5.0, 6.0, 7.0]).__next__)
    timeline.record("fit", "w", 30.0, ago=0.25)
    timeline.record("fit", "w", -1.0)
    assert [(span.begin, span.end) for span in timeline.spans] == [(0.0, 0.75), (2.0, 2.0)]


def test_a_stage_that_fails_is_in_the_timeline() -> None:
    clock = StageClock(Progress())
    with pytest.raises(ValueError, match="no"), clock.stage("fit"):
        raise ValueError("no")
    [span] = clock.timeline.to_json()["spans"]
    assert (span["name"], span["worker"], span["outcome"]) == ("fit", MASTER, "failed")


@pytest.mark.parametrize(
    ("name", "workers"),
    [
        ("serial", 1),
        ("threads", 2),
        pytest.param("processes", 2, marks=pytest.mark.slow),
        pytest.param("zmq", 2, marks=pytest.mark.slow),
    ],
)
def test_every_task_is_a_span(name: str, workers: int) -> None:
    timeline = Timeline()
    with open_executor(name, workers=workers) as opened:
        backend = opened.record(timeline)
        map_batches(backend.workforce, sees_files, [()] * 6)
    spans = timeline.spans  # a task that takes long is given to an idle worker, too
    assert [span.outcome for span in spans if span.outcome != "repeated"] == ["done"] * 6
    assert all("sees" in span.name for span in spans)
    assert all(0.0 <= span.begin <= span.end <= timeline.now() for span in spans)
    assert MASTER not in {span.worker for span in spans}
    assert (name == "serial") == (ANY_WORKER in {span.worker for span in spans})
    travels = name in ("processes", "zmq")
    assert len({span.worker for span in spans}) <= workers
    if name == "processes":
        assert all(not span.worker.endswith(f":{os.getpid()}") for span in spans)
    assert travels or not any(span.bytes_in or span.bytes_out for span in spans)


def test_a_job_fills_its_timeline(tmp_path: Path) -> None:
    directions = np.random.default_rng(0).normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    write_points(tmp_path / "ball.ply", PointCloud(directions, directions))
    settings = JobSettings(
        points=tmp_path / "ball.ply",
        output=str(tmp_path / "mesh.ply"),
        method=Paper(),  # the default one hands out no tasks of so few points
        grid=32,
        backend="serial",
    )
    timeline = Timeline()
    report = run_job(settings, Progress(), timeline=timeline)
    stages = [span for span in timeline.spans if span.worker == MASTER]
    tasks = [span for span in timeline.spans if span.worker == ANY_WORKER]
    assert {span.name for span in stages} == set(report["stages"])
    assert tasks
    by_name = {span.name: span for span in stages}
    for span in tasks:
        assert any(stage.begin <= span.begin <= span.end <= stage.end for stage in stages)
    assert by_name["read"].end <= by_name["fit"].begin
