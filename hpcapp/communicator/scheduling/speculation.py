"""The end of a job: what idle workers do when too little waits, or nothing."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from functools import cache

from hpcapp.communicator.scheduling.forecast import Forecast
from hpcapp.communicator.scheduling.state import Task, Worker

SPLIT_S = 0.5  # longer tasks may be split, where more workers than tasks are (soon) idle
# A straggler takes so many times as long as an idle worker would, with the way to it, and so many
# seconds more.
STRAGGLER_RATIO = 1.5
STRAGGLER_S = 0.25


def choose_to_split(
    queue: Collection[Task], workers: Sequence[Worker], forecast: Forecast, now: float
) -> Task | None:
    """Choose the longest waiting task that can be split, if too few wait for idle workers."""
    candidates = [task for task in queue if task.can_split and not task.is_claimed]
    if not candidates or len(queue) >= len(workers):
        return None
    idle = [worker for worker in workers if forecast.remaining_s(worker, now) <= SPLIT_S]
    if len(queue) >= len(idle):
        return None

    def expected_s(task: Task) -> float:
        return min(forecast.expect(worker.identity, task) for worker in idle)

    task = max(candidates, key=expected_s)
    return task if SPLIT_S <= expected_s(task) < math.inf else None


def choose_to_speculate(
    workers: Collection[Worker], idle: Sequence[Worker], forecast: Forecast, now: float
) -> list[tuple[Worker, Task]]:
    """Choose for idle workers the tasks that will be done last, if they are there much sooner."""
    if not idle:
        return []

    def is_straggler(task: Task, left_s: float, unit_s: float) -> bool:
        there_s = unit_s * task.work + forecast.transit_s(task.name)
        return left_s > STRAGGLER_RATIO * there_s + STRAGGLER_S

    @cache
    def least_s(name: str) -> float:  # a unit of work on whoever of the idle is fastest
        return min(forecast.unit_s(worker.identity, name) for worker in idle)

    stragglers = []
    for worker in workers:
        for task, left_s in forecast.ends(worker, now):
            if task.may_run_twice and is_straggler(task, left_s, least_s(task.name)):
                stragglers.append((left_s, task))
    stragglers.sort(key=lambda pair: -pair[0])
    chosen = []
    for worker in idle:
        for place, (left_s, task) in enumerate(stragglers):
            if is_straggler(task, left_s, forecast.unit_s(worker.identity, task.name)):
                chosen.append((worker, task))
                del stragglers[place]
                break
    return chosen
