"""A pool whose workers are watched."""

from __future__ import annotations

import os
import signal
import struct
import threading
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor

import pytest

from hpcapp.process_pool import open_processes


@pytest.mark.usefixtures("standing_helpers")
def test_a_worker_that_dies_while_it_writes_its_result_is_noticed() -> None:
    with open_processes(2) as pool:
        assert isinstance(pool, ProcessPoolExecutor)
        waiting = pool.submit(bytes, 8)
        waiting.result()
        os.write(pool._result_queue._writer.fileno(), struct.pack("!i", 1 << 20))  # and no more
        waiting = pool.submit(bytes, 8)
        os.kill(next(iter(pool._processes)), signal.SIGKILL)
        with pytest.raises(BrokenExecutor):
            waiting.result()


@pytest.mark.usefixtures("standing_helpers")
def test_the_pipe_that_the_watcher_closes_is_not_closed_a_second_time_meanwhile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    is_closing, overlapped = threading.Event(), threading.Event()
    with open_processes(1) as pool:
        assert isinstance(pool, ProcessPoolExecutor)
        writer = pool._result_queue._writer
        close, owner = writer.close, threading.current_thread()

        def close_slowly() -> None:
            if threading.current_thread() is owner:
                if is_closing.is_set():
                    overlapped.set()
                return
            is_closing.set()
            overlapped.wait(0.2)  # the owner has all the time to come by, and must not
            is_closing.clear()
            close()

        monkeypatch.setattr(writer, "close", close_slowly)
        waiting = pool.submit(os.getpid)
        os.kill(waiting.result(), signal.SIGKILL)
        is_closing.wait()
    assert not overlapped.is_set()
    assert writer.closed
