from __future__ import annotations

from dataclasses import dataclass

from hpcapp.communicator.policy import EqualPolicy, Placement, PullPolicy


@dataclass
class Load:
    queued: int = 0
    placed: int = 0


def test_equal_goes_round_robin_and_fixes_the_place() -> None:
    loads = [Load(placed=3), Load(placed=2), Load(placed=2)]
    assert EqualPolicy().place(100, loads) == Placement(1, 1, is_fixed=True)


def test_pull_takes_the_shortest_queue_until_all_are_full() -> None:
    loads = [Load(queued=1), Load(queued=0)]
    placement = PullPolicy().place(80, loads)
    assert placement == Placement(1, 10)
    assert PullPolicy().place(80, [Load(queued=2), Load(queued=2)]) is None


def test_pull_shrinks_batches_with_the_queue() -> None:
    sizes = [p.tasks for n in (64, 8, 1) if (p := PullPolicy().place(n, [Load(), Load()]))]
    assert sizes == [8, 1, 1]
