"""The executor with real sockets and real processes, and what may go wrong with them."""

from __future__ import annotations

import errno
import os
import signal
import socket
import struct
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from fixture_types import StartComponent
from raw_peer import GREETING

from hpcapp.communicator.executor import CommunicatorExecutor
from hpccomponent.errors import (
    JobError,
    NoWorkersError,
    TaskError,
    UsageError,
    WorkerLostError,
)
from hpccomponent.protocol.connection import Connection
from hpccomponent.protocol.keys import make_key_pair
from hpccomponent.protocol.messages import Heartbeat, encode_message

WAIT = 120.0  # seconds, for what takes milliseconds: only a defect runs into it


def await_file(path: Path, timeout_s: float = WAIT) -> str:
    """Wait until a task has written `path`."""
    never = threading.Event()
    for _ in range(int(timeout_s * 100)):
        if path.exists():
            return path.read_text()
        never.wait(0.01)
    raise AssertionError(f"{path} did not appear")


def await_count(executor: CommunicatorExecutor, name: str) -> None:
    """Wait until the master has counted one of something; nobody is told of it."""
    never = threading.Event()
    for _ in range(int(WAIT * 100)):
        if executor.statistics()[name]:
            return
        never.wait(0.01)
    raise AssertionError(f"no {name} were counted")


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(")")[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_worker_does_what_a_task_has_left_once_it_has_nothing_else(
    executor: CommunicatorExecutor, start_component: StartComponent, tmp_path: Path
) -> None:
    start_component()
    left, first, second = (str(tmp_path / name) for name in ("left", "first", "second"))
    Path(first).touch()
    executor.submit("contract.leave_work", left, first).result(WAIT)
    await_file(Path(left))
    Path(left).unlink()
    futures: list[Future[object]] = [
        executor.submit("contract.leave_work", left, second),
        executor.submit("contract.wait_for_file", second),
    ]
    Path(second).touch()
    for future in futures:
        future.result(WAIT)
    await_file(Path(left))
    assert executor.submit("contract.echo", 5).result(WAIT) == 5


def test_values_arrive_bit_by_bit_large_and_small(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    start_component()
    rng = np.random.default_rng(7)
    for size in (0, 3, 600, 50_000, 1_500_000):  # header, inline, shared, in pieces
        sent = rng.standard_normal(size)
        received: Any = executor.submit("contract.echo", sent).result(WAIT)
        assert received.tobytes() == sent.tobytes()
        assert not received.flags.writeable
    mixed = {"a": (1, None, "x"), "b": [sent, b"raw"]}
    received = executor.submit("contract.echo", mixed).result(WAIT)
    assert received["a"] == mixed["a"]
    assert received["b"][0].tobytes() == sent.tobytes()


def test_thousands_of_small_tasks_share_batches(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    start_component()
    start_component()
    executor.wait_for_workers(2, WAIT)
    futures: list[Future[object]] = [
        executor.submit("contract.echo", number) for number in range(2000)
    ]
    assert [future.result(WAIT) for future in futures] == list(range(2000))
    counts = executor.statistics()
    assert counts["tasks"] == 2000
    assert counts["batches"] < 500
    assert counts["bytes_sent"] > 0
    assert counts["losses"] == counts["dropped"] == counts["refused"] == 0


def test_an_exception_comes_back_with_one_line_and_the_remote_traceback(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    start_component()
    with pytest.raises(TaskError, match="ValueError: no luck") as caught:
        executor.submit("contract.fail", "no luck").result(WAIT)
    assert "\n" not in str(caught.value)
    assert "contract_tasks.py" in caught.value.__notes__[0]


def test_what_cannot_be_submitted_is_refused_at_once(executor: CommunicatorExecutor) -> None:
    with pytest.raises(UsageError, match="not a registered task"):
        executor.submit(len, [])
    with pytest.raises(UsageError, match="not a registered task"):
        executor.submit("contract.missing")
    with pytest.raises(UsageError, match="by position"):
        executor.submit("contract.echo", value=1)
    with pytest.raises(UsageError, match="cannot travel"):
        executor.submit("contract.echo", object())
    executor.shutdown()
    with pytest.raises(RuntimeError, match="after shutdown"):
        executor.submit("contract.echo", 1)


def test_workers_have_one_thread_and_a_process_of_their_own(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    component = start_component()
    found: tuple[int, int, str] = executor.submit("contract.read_process").result(WAIT)
    pid, parent, threads = found
    assert pid != component.pid == parent
    assert threads == "1"


def test_waiting_tasks_can_be_cancelled_and_running_ones_cannot(
    executor: CommunicatorExecutor, start_component: StartComponent, tmp_path: Path
) -> None:
    start_component()
    started, released = tmp_path / "started", tmp_path / "released"
    names = str(started), str(released)
    running: Future[object] = executor.submit("contract.announce_and_wait", *names)
    waiting: list[Future[object]] = [
        executor.submit("contract.echo", number) for number in range(50)
    ]
    await_file(started)
    assert not running.cancel()
    assert waiting[-1].cancel()
    with pytest.raises(CancelledError):
        waiting[-1].result()
    released.touch()
    assert [future.result(WAIT) for future in waiting[:-1]] == list(range(49))


def test_shutdown_finishes_what_is_submitted_and_the_components_leave(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    components = [start_component(), start_component()]
    executor.wait_for_workers(2, WAIT)
    futures: list[Future[object]] = [
        executor.submit("contract.echo", number) for number in range(200)
    ]
    executor.shutdown(wait=True)
    assert [future.result(0) for future in futures] == list(range(200))
    assert [component.wait() for component in components] == [0, 0]


def test_shutdown_can_cancel_what_waits(executor: CommunicatorExecutor) -> None:
    futures: list[Future[object]] = [
        executor.submit("contract.echo", number) for number in range(5)
    ]
    executor.shutdown(wait=True, cancel_futures=True)
    assert all(future.cancelled() for future in futures)


def test_leaving_with_an_error_abandons_running_tasks(
    executor: CommunicatorExecutor, start_component: StartComponent, tmp_path: Path
) -> None:
    component = start_component()
    started = tmp_path / "started"
    running: Future[object] = executor.submit(
        "contract.announce_and_wait", str(started), str(tmp_path / "never")
    )
    worker = int(await_file(started))
    with pytest.raises(KeyboardInterrupt), executor:
        raise KeyboardInterrupt
    with pytest.raises(JobError, match="shut down"):
        running.result(0)
    assert component.wait() == 0
    assert not is_alive(worker)


def kill_worker(component_pid: int, worker_pid: int) -> None:
    del component_pid
    os.kill(worker_pid, signal.SIGKILL)


def kill_component(component_pid: int, worker_pid: int) -> None:
    del worker_pid
    os.kill(component_pid, signal.SIGKILL)


def freeze_component(component_pid: int, worker_pid: int) -> None:
    del worker_pid
    os.kill(component_pid, signal.SIGSTOP)


@pytest.mark.slow
@pytest.mark.parametrize("harm", [kill_worker, kill_component, freeze_component])
def test_the_batch_of_a_lost_worker_runs_elsewhere(
    executor: CommunicatorExecutor,
    start_component: StartComponent,
    tmp_path: Path,
    harm: Callable[[int, int], None],
) -> None:
    victim = start_component()
    started, released = tmp_path / "started", tmp_path / "released"
    future: Future[object] = executor.submit(
        "contract.announce_and_wait", str(started), str(released)
    )
    worker = int(await_file(started))
    started.unlink()
    start_component()
    executor.wait_for_workers(2, WAIT)
    harm(victim.pid, worker)
    second = int(await_file(started))
    released.touch()
    assert future.result(WAIT) == second != worker
    assert executor.statistics()["losses"] == 1
    if harm is kill_component:
        assert not is_alive(worker)


def test_the_task_of_a_worker_that_hangs_is_run_again_and_its_late_answer_dropped(
    executor: CommunicatorExecutor, start_component: StartComponent, tmp_path: Path
) -> None:
    start_component()
    start_component()
    executor.wait_for_workers(2, WAIT)
    note = tmp_path / "frozen"
    note.touch()
    pids: set[int] = set()
    while len(pids) < 2:  # how long the task takes is known of both workers
        futures: list[Future[int]] = [
            executor.submit("contract.freeze_first", str(note)) for _ in range(20)
        ]
        pids |= {future.result(WAIT) for future in futures}
    note.unlink()
    futures = [executor.submit("contract.freeze_first", str(note)) for _ in range(20)]
    # Whoever begins first stops within its task; its component speaks on: nobody else would notice.
    done_by = {future.result(WAIT) for future in futures}
    hung = int(note.read_text())
    os.kill(hung, signal.SIGCONT)
    assert done_by == pids - {hung}
    await_count(executor, "duplicates")
    counts = executor.statistics()
    assert counts["losses"] == counts["dropped"] == 0


@pytest.mark.slow
def test_a_task_that_kills_every_worker_is_given_up(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    start_component()
    poison: Future[object] = executor.submit("contract.kill_worker")
    others: list[Future[object]] = [
        executor.submit("contract.echo", number) for number in range(20)
    ]
    with pytest.raises(WorkerLostError, match="SIGKILL"):
        poison.result(WAIT)
    assert [future.result(WAIT) for future in others] == list(range(20))


@pytest.mark.parametrize("lack", [errno.ENOMEM, errno.ENOSPC, errno.EMFILE])
def test_what_one_machine_lacks_another_one_does(
    executor: CommunicatorExecutor, start_component: StartComponent, tmp_path: Path, lack: int
) -> None:
    bad, good = start_component("bad"), start_component("good")
    note = tmp_path / "bad"
    note.write_text(str(bad.pid))
    executor.wait_for_workers(2, WAIT)
    while not executor.statistics()["losses"]:  # until "bad" has had one
        futures: list[Future[object]] = [
            executor.submit("contract.lack_below", str(note), lack) for _ in range(2)
        ]
        assert {future.result(WAIT) for future in futures} == {good.pid}


def test_what_every_machine_lacks_is_said(
    executor: CommunicatorExecutor, start_component: StartComponent, tmp_path: Path
) -> None:
    note = tmp_path / "bad"
    note.write_text(str(start_component("alone").pid))
    task: Future[object] = executor.submit("contract.lack_below", str(note), errno.ENOMEM)
    lacked = r"alone failed .* it lacks what 'contract.lack_below' needs \(MemoryError: no room\)"
    with pytest.raises(WorkerLostError, match=lacked):
        task.result(WAIT)


def test_a_machine_that_loses_every_worker_is_retired_and_the_others_do_its_tasks(
    executor: CommunicatorExecutor,
    start_component: StartComponent,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    bad = start_component("bad")
    note = tmp_path / "bad"
    note.write_text(str(bad.pid))
    start_component("good-1")
    start_component("good-2")
    executor.wait_for_workers(3, WAIT)
    while executor.workers == 3:  # what "bad" loses, and when, is the scheduler's affair
        futures: list[Future[object]] = [
            executor.submit("contract.kill_below", str(note)) for _ in range(12)
        ]
        assert bad.pid not in {future.result(WAIT) for future in futures}
    assert executor.workers == 2
    assert "bad gets no more of this job" in caplog.text
    assert "SIGKILL" in caplog.text


def test_a_preempted_component_says_goodbye_and_its_task_goes_on_elsewhere(
    executor: CommunicatorExecutor, start_component: StartComponent, tmp_path: Path
) -> None:
    victim = start_component()
    started, released = tmp_path / "started", tmp_path / "released"
    future: Future[object] = executor.submit(
        "contract.announce_and_wait", str(started), str(released)
    )
    await_file(started)
    started.unlink()
    start_component()
    victim.terminate()
    assert victim.wait() == 0
    await_file(started)
    released.touch()
    future.result(WAIT)
    assert executor.statistics()["losses"] == 0


def test_a_wrong_server_key_is_told_in_words(
    executor: CommunicatorExecutor,
    start_component: StartComponent,
    caplog: pytest.LogCaptureFixture,
) -> None:
    wrong = replace(executor.invite("w"), server_key=make_key_pair().public)
    component = start_component(connection=wrong)
    assert component.stderr is not None
    assert component.stderr.readline()  # it complains too
    await_count(executor, "refused")
    with pytest.raises(NoWorkersError, match="key"):
        executor.wait_for_workers(1, 0.0)


@pytest.mark.parametrize("sent", [b"", GREETING], ids=["nothing", "greeting"])
@pytest.mark.parametrize("is_reset", [True, False])
def test_a_peer_that_breaks_off_the_handshake_says_nothing_of_keys(
    executor: CommunicatorExecutor, start_component: StartComponent, sent: bytes, is_reset: bool
) -> None:
    host, port = executor.endpoint.removeprefix("tcp://").split(":")
    with socket.create_connection((host, int(port)), timeout=WAIT) as peer:
        peer.sendall(sent)
        assert peer.recv(10)
        if is_reset:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    start_component("friend")
    executor.wait_for_workers(1, WAIT)
    with pytest.raises(NoWorkersError) as raised:
        executor.wait_for_workers(2, 0.0)
    assert "key" not in str(raised.value)
    assert executor.statistics()["refused"] == 0


def test_a_key_that_is_not_on_the_list_is_told_in_words(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    stranger = make_key_pair()
    start_component(
        connection=Connection(
            executor.endpoint, executor.server_key, stranger.public, stranger.secret, "stranger"
        )
    )
    start_component("friend")
    executor.wait_for_workers(1, WAIT)
    await_count(executor, "refused")
    with pytest.raises(NoWorkersError, match="not on the list"):
        executor.wait_for_workers(2, 0.0)


def test_a_revoked_worker_leaves(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    connection = executor.invite("w")
    component = start_component("w", connection)
    executor.wait_for_workers(1, WAIT)
    executor.revoke(connection.public_key)
    assert component.wait() == 2
    assert component.stderr is not None
    assert "revoked" in component.stderr.read()
    assert executor.workers == 0


def test_a_component_of_another_numerics_id_is_refused(
    start_component: StartComponent, executor: CommunicatorExecutor
) -> None:
    executor._loop.scheduler._admission.numerics = "another machine's"
    component = start_component()
    assert component.wait(WAIT) == 2
    assert component.stderr is not None
    assert "last bits" in component.stderr.read()


@pytest.mark.parametrize(
    "frames",
    [
        [b""],
        [b"junk" * 100],
        [encode_message(Heartbeat("wrong session", 1, 0, []))],
        [b"x"] * 50,
        [b"x" * (16 << 20)],
    ],
)
def test_bad_messages_do_not_take_the_master_down(
    executor: CommunicatorExecutor, start_component: StartComponent, frames: list[bytes]
) -> None:
    connection = executor.invite("rogue")
    with zmq.Context() as context, context.socket(zmq.DEALER) as rogue:
        rogue.setsockopt(zmq.LINGER, 0)
        rogue.setsockopt(zmq.CURVE_SERVERKEY, connection.server_key.encode())
        rogue.setsockopt(zmq.CURVE_PUBLICKEY, connection.public_key.encode())
        rogue.setsockopt(zmq.CURVE_SECRETKEY, connection.secret_key.encode())
        rogue.connect(executor.endpoint)
        rogue.send_multipart(frames)
        start_component()
        assert executor.submit("contract.echo", 1).result(WAIT) == 1
        assert executor.submit("contract.echo", 2).result(WAIT) == 2
        if len(frames[0]) < 1000:
            await_count(executor, "dropped")


def test_a_peer_without_curve_gets_nowhere(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    with zmq.Context() as context, context.socket(zmq.DEALER) as plain:
        plain.setsockopt(zmq.LINGER, 0)
        plain.connect(executor.endpoint)
        plain.send(b"hello")
        start_component()
        assert executor.submit("contract.echo", 1).result(WAIT) == 1
        assert executor.workers == 1
        assert not plain.poll(0)


def test_without_workers_the_launcher_ends_the_wait(executor: CommunicatorExecutor) -> None:
    future: Future[object] = executor.submit("contract.echo", 1)
    executor.workers_gone("all loaders have ended")
    with pytest.raises(NoWorkersError, match="all loaders have ended"):
        future.result(WAIT)
    with pytest.raises(NoWorkersError, match="all loaders have ended"):
        executor.wait_for_workers(1, WAIT)


def test_a_defect_of_the_communicator_fails_every_future(
    executor: CommunicatorExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executor._loop.scheduler, "tick", lambda: 1 / 0)
    for _ in range(2):  # before the thread ends, and after
        with pytest.raises(JobError, match="the communicator broke: ZeroDivisionError"):
            executor.submit("contract.echo", 1).result(WAIT)
