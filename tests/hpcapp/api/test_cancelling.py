"""Jobs that end because another thread, or whoever awaits them, says so."""

from __future__ import annotations

import asyncio
import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pytest
from process_tree import descendants

import hpcapp
from hpcapp.backends.serial import SerialExecutor
from hpcapp.cancellation import Cancellation
from hpcapp.workforce import Workforce, begin_batch, map_batches
from hpccomponent.errors import JobCancelledError

LASTING = ("resource_tracker", "GarbageCollectorThread")  # of multiprocessing, and of zmq
WAIT_S = 60.0


@pytest.fixture(scope="module")
def scan() -> hpcapp.PointCloud:
    return hpcapp.simulate("torus", points=6000)


@pytest.fixture
def nothing_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Look at what a test leaves: processes, threads and files."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    threads, processes = set(threading.enumerate()), descendants(os.getpid())
    yield
    assert [one for one in processes ^ descendants(os.getpid()) if not is_lasting(one)] == []
    new = set(threading.enumerate()) - threads
    assert [one for one in new if type(one).__name__ not in LASTING] == []
    assert list(tmp_path.iterdir()) == []


def is_lasting(pid: int) -> bool:
    try:
        return LASTING[0].encode() in Path(f"/proc/{pid}/cmdline").read_bytes()
    except FileNotFoundError:
        return True


def cancel_at(stage: str, cancel: Cancellation) -> Callable[[str, int, int], None]:
    """Return what has another thread cancel as soon as a stage begins."""

    def report(name: str, done: int, total: int) -> None:
        del done, total
        if name == stage:
            thread = threading.Thread(target=cancel.cancel)
            thread.start()
            thread.join()

    return report


@pytest.mark.usefixtures("nothing_left")
@pytest.mark.parametrize("stage", ["arrange", "fit", "extract"])
@pytest.mark.parametrize("executor", ["serial", "threads", "processes", "zmq"])
def test_a_cancelled_job_leaves_nothing(scan: hpcapp.PointCloud, executor: str, stage: str) -> None:
    cancel = hpcapp.Cancellation()
    with pytest.raises(hpcapp.JobCancelledError, match="the job was cancelled"):
        hpcapp.reconstruct(
            scan,
            grid=64,
            executor=executor,
            workers=None if executor == "serial" else 2,
            cancel=cancel,
            on_progress=cancel_at(stage, cancel),
        )
    assert cancel.is_cancelled


def test_a_job_that_is_cancelled_before_it_begins_does_nothing(tmp_path: Path) -> None:
    cancel = hpcapp.Cancellation()
    cancel.cancel()
    cancel.cancel()
    seen: list[str] = []
    with pytest.raises(JobCancelledError):
        hpcapp.reconstruct(
            hpcapp.simulate("torus", points=500),
            cancel=cancel,
            on_progress=lambda stage, done, total: seen.append(stage),
        )
    assert seen == []


def test_who_does_not_cancel_gets_the_mesh(scan: hpcapp.PointCloud) -> None:
    mesh = hpcapp.reconstruct(scan, grid=32, cancel=hpcapp.Cancellation())
    assert mesh.vertices.tobytes() == hpcapp.reconstruct(scan, grid=32).vertices.tobytes()


class NeverDone(Executor):
    """Takes tasks, and has somebody cancel as soon as the caller waits for one."""

    def __init__(self, cancel: Cancellation) -> None:
        self.taken: list[Future[Any]] = []
        self._cancel = cancel

    def submit(self, fn: Callable[..., Any], /, *args: object, **kwargs: object) -> Future[Any]:
        future = Waited(self._cancel)
        self.taken.append(future)
        return future


class Waited(Future[Any]):
    """A future whose result nobody ever has."""

    def __init__(self, cancel: Cancellation) -> None:
        super().__init__()
        self._waiters = Waiters(cancel)


class Waiters(list[Any]):
    """Has another thread cancel when somebody begins to wait."""

    def __init__(self, cancel: Cancellation) -> None:
        super().__init__()
        self._cancel = cancel

    def append(self, waiter: Any) -> None:
        super().append(waiter)
        threading.Thread(target=self._cancel.cancel).start()


def test_whoever_waits_for_results_that_never_come_is_woken() -> None:
    cancel = Cancellation()
    executor = NeverDone(cancel)
    with pytest.raises(JobCancelledError):
        map_batches(Workforce(executor, cancellation=cancel), abs, [(1,), (2,)])
    assert [future.cancelled() for future in executor.taken] == [True, True]


def test_whoever_waits_for_one_result_is_woken_too() -> None:
    cancel = Cancellation()
    with (
        pytest.raises(JobCancelledError),
        begin_batch(Workforce(NeverDone(cancel), cancellation=cancel), abs, (1,)) as wait,
    ):
        wait()


class Meeting(SerialExecutor):
    """Runs no task before a task of another job wants to run as well."""

    def __init__(self, barrier: threading.Barrier) -> None:
        self._barrier: threading.Barrier | None = barrier

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        barrier, self._barrier = self._barrier, None
        if barrier is not None:
            barrier.wait(WAIT_S)
        return super().submit(fn, *args, **kwargs)


def test_two_jobs_run_at_once(scan: hpcapp.PointCloud) -> None:
    barrier = threading.Barrier(2)

    async def main() -> list[hpcapp.Mesh]:
        jobs = [
            hpcapp.reconstruct_async(scan, grid=grid, executor=Meeting(barrier), viewpoints=None)
            for grid in (32, 48)
        ]
        return await asyncio.gather(*jobs)

    meshes = asyncio.run(main())
    for mesh, grid in zip(meshes, (32, 48), strict=True):
        alone = hpcapp.reconstruct(scan, grid=grid)
        assert mesh.vertices.tobytes() == alone.vertices.tobytes()


def test_the_loop_is_told_of_progress(scan: hpcapp.PointCloud) -> None:
    tellers: set[int] = set()

    async def main() -> None:
        await hpcapp.reconstruct_async(
            scan, grid=32, on_progress=lambda *_: tellers.add(threading.get_ident())
        )

    asyncio.run(main())
    assert tellers == {threading.get_ident()}


@pytest.mark.usefixtures("nothing_left")
@pytest.mark.parametrize("executor", ["serial", "zmq"])
def test_cancelling_the_task_cancels_the_job(scan: hpcapp.PointCloud, executor: str) -> None:
    async def main() -> None:
        begun = asyncio.Event()
        job = asyncio.create_task(
            hpcapp.reconstruct_async(
                scan, grid=256, executor=executor, on_progress=lambda *_: begun.set()
            )
        )
        await begun.wait()
        job.cancel()
        with pytest.raises(asyncio.CancelledError):
            await job

    asyncio.run(main())


def test_an_awaited_job_is_cancelled_by_others_too(scan: hpcapp.PointCloud) -> None:
    async def main() -> None:
        cancel = hpcapp.Cancellation()
        with pytest.raises(hpcapp.JobCancelledError):
            await hpcapp.reconstruct_async(
                scan, grid=256, cancel=cancel, on_progress=lambda *_: cancel.cancel()
            )

    asyncio.run(main())


def test_errors_come_out_of_awaiting() -> None:
    with pytest.raises(hpcapp.InputError, match="no-such-scan"):
        asyncio.run(hpcapp.reconstruct_async("no-such-scan.ply"))


class AtLook(Cancellation):
    """Has something done when a job looks at it for so manieth time."""

    def __init__(self, number: int, act: Callable[[Cancellation], object]) -> None:
        super().__init__()
        self.looks = 0
        self._number, self._act = number, act

    def check(self) -> None:
        self.looks += 1
        if self.looks == self._number:
            self._act(self)
        super().check()


def interrupt(_: Cancellation) -> None:
    raise KeyboardInterrupt


@pytest.mark.usefixtures("nothing_left")
@pytest.mark.parametrize(
    ("act", "error"),
    [(Cancellation.cancel, JobCancelledError), (interrupt, KeyboardInterrupt)],
)
def test_a_job_ends_at_any_of_its_looks(
    scan: hpcapp.PointCloud,
    act: Callable[[Cancellation], object],
    error: type[BaseException],
) -> None:
    for number in (1, 2, 3, 5, 8, 13, 21, 34):  # of some forty
        cancel = AtLook(number, act)
        with pytest.raises(error):
            hpcapp.reconstruct(scan, grid=64, executor="threads", workers=2, cancel=cancel)
        assert cancel.is_cancelled == (error is JobCancelledError)
