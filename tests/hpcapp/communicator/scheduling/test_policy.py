from __future__ import annotations

import math
from dataclasses import dataclass

from hpcapp.communicator.scheduling.policy import (
    AdaptivePolicy,
    EqualPolicy,
    PullPolicy,
    TaskPlacement,
)


@dataclass
class Load:
    queued: int = 0
    placed: int = 0
    remaining_s: float = 0.0
    next_s: float = 0.0
    slowness: float = 1.0


def test_equal_goes_round_robin_and_fixes_the_place() -> None:
    loads = [Load(placed=3), Load(placed=2), Load(placed=2)]
    assert EqualPolicy().place(100, loads) == TaskPlacement(1, 1, is_fixed=True)


def test_pull_takes_the_shortest_queue_until_all_are_full() -> None:
    loads = [Load(queued=1), Load(queued=0)]
    placement = PullPolicy().place(80, loads)
    assert placement == TaskPlacement(1, 10)
    assert PullPolicy().place(80, [Load(queued=2), Load(queued=2)]) is None


def test_pull_shrinks_batches_with_the_queue() -> None:
    sizes = [p.tasks for n in (64, 8, 1) if (p := PullPolicy().place(n, [Load(), Load()]))]
    assert sizes == [8, 1, 1]


def adaptive(waiting: int, *loads: Load) -> tuple[int, int] | None:
    placement = AdaptivePolicy().place(waiting, loads)
    return None if placement is None else (placement.worker, placement.tasks)


def test_adaptive_gives_one_task_to_each_idle_worker_while_nothing_is_known() -> None:
    unknown = Load(next_s=math.inf)
    busy = Load(queued=1, remaining_s=math.inf, next_s=math.inf)
    assert adaptive(10, busy, unknown) == (1, 1)
    assert adaptive(10, busy, busy) is None
    slow, fast = (Load(next_s=math.inf, slowness=times) for times in (4.0, 0.9))
    assert adaptive(1, busy, slow, unknown, fast) == (3, 1)


def test_adaptive_gives_by_speed_and_less_towards_the_end() -> None:
    fast, slow = Load(next_s=0.001), Load(next_s=0.003)
    assert adaptive(400, slow, fast) == (1, 75)
    assert adaptive(400, slow) == (0, 100)
    assert adaptive(4, slow, fast) == (1, 1)


def test_adaptive_holds_back_the_second_batch_until_the_first_is_about_to_end() -> None:
    assert adaptive(9, Load(queued=1, remaining_s=30.0, next_s=5.0)) is None
    assert adaptive(9, Load(queued=1, remaining_s=0.5, next_s=5.0)) == (0, 3)
    assert adaptive(9, Load(queued=2, remaining_s=0.5, next_s=5.0)) is None


def test_adaptive_gives_nothing_to_who_would_be_last() -> None:
    slow, busy = Load(next_s=10.0), Load(queued=1, remaining_s=2.0, next_s=1.0)
    assert adaptive(3, slow, busy) is None
    assert adaptive(30, slow, busy) == (0, 1)
    assert adaptive(3, slow, Load(queued=1, remaining_s=math.inf, next_s=1.0)) == (0, 1)
    assert adaptive(1, slow, Load(next_s=10.1)) == (0, 1)  # one of two idle workers gets it
