"""What a job does between two looks at whether somebody has cancelled it."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hpcapp.cancellation import Cancellation, JobThreads, check_cancelled
from hpcapp.kernels.build import load_native
from hpcapp.kernels.parallel import run_batches
from hpccomponent.errors import JobCancelledError


class Counting(Cancellation):
    """Counts the looks, and does something at one of them."""

    def __init__(self, at: int, act: Callable[[], object]) -> None:
        super().__init__()
        self.looks = 0
        self._at, self._act = at, act

    def check(self) -> None:
        self.looks += 1
        if self.looks == self._at:
            self._act()
        super().check()


def test_only_the_work_of_the_block_heeds_it() -> None:
    cancellation, other = Cancellation(), Cancellation()
    cancellation.cancel()
    check_cancelled()
    with other.heeded():
        with cancellation.heeded(), pytest.raises(JobCancelledError):
            check_cancelled()
        check_cancelled()
    thread = threading.Thread(target=check_cancelled)
    thread.start()
    thread.join()


@pytest.mark.parametrize("threads", [1, 2])
def test_no_batch_begins_once_the_job_is_cancelled(threads: int) -> None:
    cancellation, begun = Cancellation(), []

    def run(batch: int) -> None:
        begun.append(batch)
        if batch == 4:
            cancellation.cancel()

    with cancellation.heeded(), pytest.raises(JobCancelledError):
        run_batches(run, range(1000), threads)
    assert 4 in begun
    assert len(begun) <= 4 + threads


def test_a_batch_that_fails_ends_the_others() -> None:
    failed = threading.Event()

    def run(batch: int) -> None:
        if batch == 0:
            failed.set()
            raise ValueError("of the batch")
        failed.wait()
        while True:  # as a kernel does between its chunks
            check_cancelled()

    with pytest.raises(ValueError, match="of the batch"):
        run_batches(run, range(4), 2)
    check_cancelled()


def test_threads_belong_to_the_job_that_opens_them() -> None:
    cancellation = Cancellation()
    with cancellation.heeded(), JobThreads(2, "worker") as pool:
        assert pool.submit(pow, 2, 3).result() == 8
        cancellation.cancel()
        with pytest.raises(JobCancelledError):
            pool.submit(pow, 2, 3).result()


def search(count: int) -> Callable[[], Any]:
    """Return a kernel with much to do: so many keys that are looked for in no order."""
    native = load_native("")
    if native is None:
        pytest.skip("the native kernels are not installed")
    keys = np.arange(0, 1 << 24, 3)
    wanted = np.random.default_rng(3).integers(0, 1 << 24, count)
    return lambda: native.find_keys(keys, wanted, 2)


def test_a_kernel_ends_amid_its_rows() -> None:
    find = search(20_000_000)
    counting = Counting(3, lambda: counting.cancel())
    with counting.heeded(), pytest.raises(JobCancelledError):
        find()
    assert counting.looks == 3


def test_a_kernel_ends_for_a_signal() -> None:
    """Python itself would tell of it only when the kernel is done."""
    find = search(20_000_000)
    counting = Counting(2, lambda: threading.Thread(target=os.kill, args=sent).start())
    sent = os.getpid(), signal.SIGINT
    with counting.heeded(), pytest.raises(KeyboardInterrupt):
        find()
    assert counting.looks <= 4
