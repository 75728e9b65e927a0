"""Peers with a listed key that send without end, over real sockets, beside an honest worker."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest
from fixture_types import StartComponent
from peak_memory import bounded_memory

from hpcapp.communicator.executor import CommunicatorExecutor
from hpcapp.geometry.points import FloatArray
from hpccomponent.protocol.connection import write_connection

HELPERS = Path(__file__).parents[2] / "helpers"
WAIT = 60.0
WITHOUT_END = ["large frames", "frames of a byte", "frames of 34 bytes", "a drip"]
OTHERS = ["before it registers", "many connections"]
WHOLE_MESSAGES = ["heartbeats", "heads", "results", "pieces"]

Flood = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def flood(executor: CommunicatorExecutor, tmp_path: Path) -> Iterator[Flood]:
    """Start peers that flood the master; they end with the test."""
    started: list[subprocess.Popen[str]] = []

    def start(what: str, name: str = "") -> subprocess.Popen[str]:
        name = name or f"flood-{len(started)}"
        path = tmp_path / f"{name}.json"
        if not path.exists():
            write_connection(path, executor.invite(name))
        process = subprocess.Popen(
            [sys.executable, "-m", "raw_peer", str(path), what],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=os.environ | {"PYTHONPATH": str(HELPERS)},
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def is_ready(flooder: subprocess.Popen[str]) -> bool:
    """Wait until a peer floods the master; False where it is not let in."""
    assert flooder.stdout is not None
    return flooder.stdout.readline() == "ready\n"


def do_work(executor: CommunicatorExecutor) -> None:
    """Have a job done, small results and large ones."""
    values = np.arange(400_000.0)
    futures: list[Future[FloatArray]] = []
    futures += [executor.submit("contract.echo", values + number) for number in range(6)]
    futures += [executor.submit("contract.echo", values[:10] + number) for number in range(60)]
    for number, future in enumerate(futures):
        offset = number if number < 6 else number - 6
        assert np.array_equal(future.result(WAIT), values[: len(future.result())] + offset)


@pytest.mark.slow
@pytest.mark.parametrize("what", [*WITHOUT_END, *OTHERS])
def test_what_never_ends_is_ended(
    executor: CommunicatorExecutor, start_component: StartComponent, flood: Flood, what: str
) -> None:
    start_component()
    executor.wait_for_workers(1, WAIT)
    do_work(executor)
    with bounded_memory():
        flooder = flood(what)
        assert is_ready(flooder)
        do_work(executor)
        assert flooder.communicate(timeout=WAIT)[0] == "closed\n"
    do_work(executor)


@pytest.mark.slow
def test_who_sends_without_end_and_without_a_key_is_cut_off(
    executor: CommunicatorExecutor,
    start_component: StartComponent,
    flood: Flood,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """By what it sends, not by the end of the handshake's time: 128 MiB come of 1.6 GB to come."""
    start_component()
    executor.wait_for_workers(1, WAIT)
    do_work(executor)
    with bounded_memory():
        flooder = flood("without a key")
        assert is_ready(flooder)
        do_work(executor)
        assert flooder.communicate(timeout=WAIT)[0] == "closed\n"
    assert "a connection that sent without end was closed; its key is not known" in caplog.text
    do_work(executor)


def test_who_sends_without_end_is_turned_away(
    executor: CommunicatorExecutor, flood: Flood, caplog: pytest.LogCaptureFixture
) -> None:
    flooder = flood("large frames", "liar")
    assert is_ready(flooder)
    assert flooder.communicate(timeout=WAIT)[0] == "closed\n"
    assert not is_ready(flood("large frames", "liar"))
    assert executor.statistics()["lies"] == 1
    assert "liar works for this job no more: it sent a message without end" in caplog.text


@pytest.mark.slow
@pytest.mark.parametrize("what", WHOLE_MESSAGES)
def test_whole_messages_as_fast_as_they_come_cost_no_memory(
    executor: CommunicatorExecutor, start_component: StartComponent, flood: Flood, what: str
) -> None:
    start_component()
    executor.wait_for_workers(1, WAIT)
    do_work(executor)
    with bounded_memory():
        assert is_ready(flood(what))
        for _ in range(3):
            do_work(executor)


def test_probes_that_a_peer_leaves_behind_in_a_full_queue_do_no_harm(
    executor: CommunicatorExecutor, start_component: StartComponent, flood: Flood
) -> None:
    """With a bounded queue libzmq would abort this process ("Assertion failed: !_io_error")."""
    start_component()
    for _ in range(3):
        assert flood("probes left behind").communicate(timeout=WAIT)[0] == "ready\nclosed\n"
    executor.wait_for_workers(1, WAIT)
    do_work(executor)


@pytest.mark.slow
def test_several_that_never_end_at_once(
    executor: CommunicatorExecutor, start_component: StartComponent, flood: Flood
) -> None:
    start_component()
    executor.wait_for_workers(1, WAIT)
    do_work(executor)
    with bounded_memory():
        flooders = [flood(what) for what in WITHOUT_END]
        for flooder in flooders:
            assert is_ready(flooder)
        do_work(executor)
        for flooder in flooders:
            assert flooder.communicate(timeout=WAIT)[0] == "closed\n"
    do_work(executor)
