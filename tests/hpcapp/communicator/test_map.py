"""Many items in one message, and tasks that are split, with real processes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fixture_types import StartComponent

from hpcapp.communicator.executor import CommunicatorExecutor
from hpcapp.communicator.scheduling import speculation as endgame
from hpccomponent.errors import TaskError, UsageError

WAIT = 30.0


def test_items_travel_together_and_come_back_in_their_order(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    start_component()
    executor.wait_for_workers(1, WAIT)
    assert list(executor.map("contract.echo", range(5000), timeout=WAIT)) == list(range(5000))
    assert executor.statistics()["tasks"] == 16
    pairs: Any = executor.map("contract.echo", [1, 2, 3], "ab", timeout=WAIT, chunksize=1)
    assert list(pairs) == [(1, "a"), (2, "b")]
    assert list(executor.map("contract.echo", [])) == []


def test_shared_values_may_stand_among_the_items(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    start_component()
    blob = executor.share((np.arange(10_000.0), None))
    results: Any = executor.map("contract.add_to_first", [blob] * 50, range(50), timeout=WAIT)
    assert list(results) == list(range(50))
    assert executor.statistics()["blobs"] == 1


def test_what_is_wrong_with_a_map_is_told(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    start_component()
    with pytest.raises(TaskError, match="ValueError: no luck"):
        list(executor.map("contract.fail", ["no luck"] * 3, timeout=WAIT))
    with pytest.raises(UsageError, match="a chunk of 0 items"):
        executor.map("contract.echo", [1], chunksize=0)


def test_who_waits_too_long_is_told(executor: CommunicatorExecutor) -> None:
    with pytest.raises(TimeoutError):
        list(executor.map("contract.echo", range(5), timeout=0.01))


def test_a_part_is_split_where_workers_are_idle(
    executor: CommunicatorExecutor, start_component: StartComponent, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(endgame, "SPLIT_S", 0.0)
    for _ in range(3):
        start_component()
    executor.wait_for_workers(3, WAIT)
    for _ in range(2):  # the first teaches how long it takes
        results: Any = executor.map("contract.echo", range(100), timeout=WAIT, chunksize=100)
        assert list(results) == list(range(100))
    assert executor.statistics()["splits"] >= 1
