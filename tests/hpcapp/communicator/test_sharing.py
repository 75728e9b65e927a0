"""Shared values with real sockets and real processes."""

from __future__ import annotations

import gc
import os
import signal
import threading
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contract_tasks import Pair
from fixture_types import StartComponent

from hpcapp.communicator.executor import CommunicatorExecutor
from hpccomponent.errors import UsageError

WAIT = 30.0


def test_a_shared_value_travels_once_to_each_machine(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    values = np.random.default_rng(1).random(200_000)
    blob = executor.share((values, {"small": np.arange(3)}))
    assert executor.share((values.copy(), {"small": np.arange(3)})) is blob
    start_component()
    start_component()
    executor.wait_for_workers(2, WAIT)
    futures: list[Future[object]] = [
        executor.submit("contract.add_to_first", blob, i) for i in range(40)
    ]
    for number, future in enumerate(futures):
        assert future.result(WAIT) == values[0] + number
    nested: Any = executor.submit("contract.echo", [blob, 7]).result(WAIT)
    assert nested[0][0].tobytes() == values.tobytes()
    assert not nested[0][0].flags.writeable
    counts = executor.statistics()
    assert counts["blobs"] <= 2
    assert counts["bytes_sent"] < 3 * values.nbytes


def test_a_shared_record_arrives_before_its_module_is_imported(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    pair = Pair("word", 3)
    blob = executor.share(pair)
    start_component()
    executor.wait_for_workers(1, WAIT)
    assert executor.submit("contract.echo", blob, (blob, 1)).result(WAIT) == (pair, (pair, 1))


def test_a_worker_that_is_started_again_gets_the_value_from_its_component(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    blob = executor.share(np.arange(100_000.0))
    start_component()
    found: tuple[int, int, str] = executor.submit("contract.read_process").result(WAIT)
    assert executor.submit("contract.total", blob).result(WAIT) == sum(range(100_000))
    os.kill(found[0], signal.SIGKILL)
    assert executor.submit("contract.total", blob).result(WAIT) == sum(range(100_000))
    assert executor.statistics()["blobs"] == 1


def memory_files(pid: int) -> int:
    found = 0
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            found += "memfd:hpc" in str(entry.readlink())
        except OSError:
            continue
    return found


def test_a_component_lets_go_of_what_nobody_refers_to(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    component = start_component()
    blob = executor.share(np.arange(100_000.0))
    executor.submit("contract.total", blob).result(WAIT)
    assert memory_files(component.pid) == 1
    del blob
    gc.collect()
    never = threading.Event()
    for _ in range(int(WAIT * 100)):
        if not memory_files(component.pid):
            return
        never.wait(0.01)
    raise AssertionError("the component keeps a blob that nobody can name")


def test_a_value_that_is_changed_after_it_was_shared_fails_its_tasks_in_words(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    values = np.arange(100_000.0)
    blob = executor.share(values)
    values[5] = -1.0
    start_component()
    with pytest.raises(UsageError, match="was changed while tasks use it"):
        executor.submit("contract.total", blob).result(WAIT)
    assert executor.submit("contract.echo", 3).result(WAIT) == 3


def test_what_cannot_travel_cannot_be_shared(executor: CommunicatorExecutor) -> None:
    with pytest.raises(UsageError, match="cannot travel"):
        executor.share(object())
    with pytest.raises(UsageError, match="more than 256"):
        executor.submit("contract.echo", [executor.share(number) for number in range(257)])
