"""A watched job as Prometheus reads it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator
from typing import TypeVar

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from hpcapp.dashboard.watched_job import WatchedJob
from hpcapp.timeline import MASTER, Span

Key = TypeVar("Key", bound=Hashable)


def write_metrics(job: WatchedJob) -> bytes:
    """Return the metrics of a job in the text format of Prometheus.

    See https://prometheus.io/docs/instrumenting/exposition_formats/
    """
    registry = CollectorRegistry()
    registry.register(_Collector(job))
    return generate_latest(registry)


class _Collector(Collector):
    """Makes the metrics of a job anew for each scrape."""

    def __init__(self, job: WatchedJob) -> None:
        self._job = job

    def collect(self) -> Iterable[Metric]:
        """Yield all of them."""
        job = self._job
        spans = list(job.timeline.spans)
        yield from _job_metrics(job)
        yield from _task_metrics([span for span in spans if span.worker != MASTER])
        stages = GaugeMetricFamily(
            "hpcapp_stage_seconds", "Time that a finished stage took.", labels=["stage"]
        )
        for name, seconds in _sum((span.name, span.end - span.begin) for span in spans
                                  if span.worker == MASTER).items():  # fmt: skip
            stages.add_metric([name], seconds)
        yield stages


def _job_metrics(job: WatchedJob) -> Iterator[Metric]:
    yield GaugeMetricFamily("hpcapp_job_seconds", "Time since the job's start.", job.timeline.now())
    state = GaugeMetricFamily("hpcapp_job_state", "1 for the job's state.", labels=["state"])
    for name in ("running", "done", "failed"):
        state.add_metric([name], float(job.state == name))
    yield state
    yield GaugeMetricFamily("hpcapp_mesh_parts", "Parts of the mesh that have come.", job.parts)
    workers = GaugeMetricFamily(
        "hpcapp_workers", "Workers that the backend knows, by state.", labels=["state"]
    )
    for name, count in _sum((worker.state, 1.0) for worker in job.timeline.list_workers()).items():
        workers.add_metric([name], count)
    yield workers
    stage = job.stage
    for name, text, value in (
        ("done", "Finished parts of the present stage.", stage.done if stage else 0),
        ("total", "All parts of the present stage, 0 where it does not tell.",
         stage.total if stage else 0),
    ):  # fmt: skip
        gauge = GaugeMetricFamily(f"hpcapp_stage_parts_{name}", text, labels=["stage"])
        if stage is not None:
            gauge.add_metric([stage.name], value)
        yield gauge


def _task_metrics(tasks: list[Span]) -> Iterator[Metric]:
    counted = CounterMetricFamily(
        "hpcapp_tasks", "Tasks that have ended.", labels=["task", "worker", "outcome"]
    )
    for (name, worker, outcome), count in _sum(
        ((span.name, span.worker, span.outcome), 1.0) for span in tasks
    ).items():
        counted.add_metric([name, worker, outcome], count)
    yield counted
    measures: tuple[tuple[str, str, Callable[[Span], float]], ...] = (
        ("busy_seconds", "Time that tasks took.", lambda span: span.end - span.begin),
        ("received_bytes", "What the master received for tasks.", lambda span: span.bytes_in),
        ("sent_bytes", "What the master sent for tasks.", lambda span: span.bytes_out),
    )
    for name, text, measure in measures:
        counter = CounterMetricFamily(f"hpcapp_worker_{name}", text, labels=["worker"])
        for worker, value in _sum((span.worker, measure(span)) for span in tasks).items():
            counter.add_metric([worker], value)
        yield counter


def _sum(values: Iterable[tuple[Key, float]]) -> dict[Key, float]:
    sums: defaultdict[Key, float] = defaultdict(float)
    for key, value in values:
        sums[key] += value
    return dict(sums)
