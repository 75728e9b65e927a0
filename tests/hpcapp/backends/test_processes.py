"""A pool whose workers are watched."""

from __future__ import annotations

import os
import signal
import struct
import threading
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from hpcapp.backends.processes import _watch_workers, open_processes
from hpcapp.backends.selection import open_executor
from hpccomponent.errors import WorkerLostError


def test_a_worker_that_dies_while_it_writes_its_result_is_noticed() -> None:
    with open_processes(2) as pool:
        assert isinstance(pool, ProcessPoolExecutor)
        waiting = pool.submit(bytes, 8)
        waiting.result()
        results: Any = pool._result_queue
        os.write(results._writer.fileno(), struct.pack("!i", 1 << 20))  # and no more
        waiting = pool.submit(bytes, 8)
        os.kill(next(iter(pool._processes)), signal.SIGKILL)
        with pytest.raises(BrokenExecutor):
            waiting.result()


def test_the_pipe_that_the_watcher_closes_is_not_closed_a_second_time_meanwhile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    is_closing, is_closed, has_come = threading.Event(), threading.Event(), threading.Event()
    owner, join = threading.current_thread(), threading.Thread.join
    is_second: list[bool] = []  # of each time that the owner closes the pipe

    def join_and_say_so(thread: threading.Thread, timeout: float | None = None) -> None:
        if thread.name == "pool watcher":
            has_come.set()
        join(thread, timeout)

    monkeypatch.setattr(threading.Thread, "join", join_and_say_so)
    with open_processes(1) as pool:
        assert isinstance(pool, ProcessPoolExecutor)
        results: Any = pool._result_queue
        writer = results._writer
        close = writer.close

        def close_in_turn() -> None:
            if threading.current_thread() is owner:
                is_second.append(is_closed.is_set())
                has_come.set()
                return
            is_closing.set()
            has_come.wait()  # until the owner waits for the watcher, or closes what it closes
            close()
            is_closed.set()

        monkeypatch.setattr(writer, "close", close_in_turn)
        waiting = pool.submit(os.getpid)
        os.kill(waiting.result(), signal.SIGKILL)
        is_closing.wait()
    assert is_second
    assert all(is_second)
    assert writer.closed


@pytest.mark.parametrize(("codes", "is_lost"), [([None, None, -9], True), ([None, 0], False)])
def test_an_exit_code_that_another_thread_notes_is_waited_for(
    codes: list[int | None], is_lost: bool
) -> None:
    """The pool's own thread collects workers, too, and notes how one ended a moment later."""

    class Ended:
        def __init__(self) -> None:
            self.sentinel, writer = os.pipe()
            os.close(writer)

        @property
        def exitcode(self) -> int | None:
            return codes.pop(0) if len(codes) > 1 else codes[0]

        def join(self) -> None:
            """Find that somebody else has collected it."""

    class Pipe:
        is_closed = False

        def close(self) -> None:
            self.is_closed = True

    process, pipe = Ended(), Pipe()
    try:
        _watch_workers([process], pipe)
    finally:
        os.close(process.sentinel)
    assert pipe.is_closed == is_lost


def fail_at_work(pipe: Path, writers: list[int], running: list[Future[bytes]]) -> None:
    with open_executor("processes", workers=1) as backend:
        running.append(backend.executor.submit(pipe.read_bytes))
        writers.append(os.open(pipe, os.O_WRONLY))  # when the task has opened it too
        raise ValueError("mine")


def test_an_error_in_the_block_does_not_wait_for_what_runs(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writers: list[int] = []
    running: list[Future[bytes]] = []
    with pytest.raises(ValueError, match="mine"):
        fail_at_work(tmp_path / "pipe", writers, running)
    with pytest.raises(WorkerLostError):
        running[0].result()
    os.close(writers[0])
