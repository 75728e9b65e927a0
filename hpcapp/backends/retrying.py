"""An Executor around another one: a task whose worker was lost runs again, on the same bits.

So does one whose worker ran out of memory, disk or open files: another one may have them.

Engines differ in what they do when a worker dies: a process pool breaks, and with it every task
that waits; Dask tries again by itself; MPI ends the whole job. Here is the one place where such
losses are counted, made good and at last translated.

::

    submit ──> inner future ──> done ──> outer future
                    │                        ^
                    └── lost ─> mender ──────┘  too often: WorkerLostError
                                  │
                                  └── opens a broken engine anew, submits once more

The mender is a thread of its own, since the engine's thread, which brings the bad news, must not
wait for the engine's end.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent import futures
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack
from typing import Any, TypeVar

from hpcapp.backends.calls import TaskOutcome, align, count_bytes, run_task
from hpcapp.timeline import ANY_WORKER, Timeline, note_worker
from hpccomponent.errors import WorkerLostError
from hpccomponent.limits import available_cores, is_shortage
from hpccomponent.runtime.numerics import numerics_id

T = TypeVar("T")

MOST_LOSSES = 3
"""A task is given up with the loss after these: what it needs, no worker has."""


def count_broken(error: BaseException) -> int:
    """Return how many workers an error tells the loss of, on pools of the standard library's kind.

    Examples
    --------
    >>> count_broken(BrokenExecutor()), count_broken(ValueError())
    (1, 0)
    """
    return int(isinstance(error, BrokenExecutor))


def count_workers(executor: Executor) -> int:
    """Return how many tasks an Executor runs at once, as far as it tells; else the cores here.

    No Executor has to tell. Those of the standard library, loky and mpi4py have ``_max_workers``; a
    wrong guess only makes batches larger or smaller.

    Examples
    --------
    >>> count_workers(ThreadPoolExecutor(3))
    3
    """
    known = getattr(executor, "_max_workers", None)
    return known if isinstance(known, int) and known > 0 else available_cores()


class _Task(Future[T]):
    """What the caller holds: done when some worker has done it."""

    def __init__(self, function: Callable[..., T], arguments: tuple[object, ...]) -> None:
        super().__init__()
        self.function = function
        self.arguments = arguments
        self.inner: Future[TaskOutcome[T]] | None = None
        self.since = 0.0
        self.losses = 0
        self.is_unwanted = False

    def cancel(self) -> bool:
        """Cancel the task unless the engine runs it already, or it is done."""
        inner = self.inner
        if inner is None or self.done():
            return super().cancel()
        self.is_unwanted = True
        return inner.cancel()  # which ends this one, see RetryingExecutor._finish

    @property
    def name(self) -> str:
        """The name of the task's function."""
        return getattr(self.function, "__name__", repr(self.function))

    def succeed(self, result: T) -> None:
        """Be done with a result, and let go of the arguments."""
        if self._is_wanted():
            self.set_result(result)

    def fail(self, error: BaseException) -> None:
        """Be done with an error, and let go of the arguments."""
        if self._is_wanted():
            self.set_exception(error)

    def give_up(self) -> None:
        """Be cancelled, as the caller wanted when the engine had it already."""
        Future.cancel(self)
        self._is_wanted()

    def _is_wanted(self) -> bool:
        self.arguments, self.inner = (), None
        return self.set_running_or_notify_cancel()


class RetryingExecutor(Executor):
    """Runs tasks on an engine, and runs those again whose worker was lost.

    Parameters
    ----------
    open_engine : callable
        Opens the engine: a context manager of its Executor. Called again when it is broken.
    workers : int, optional
        How many tasks it runs at once; by default what `count_workers` finds.
    count_losses : callable
        How many workers an error tells the loss of; 0 where it is the task's own.
    most_losses : int
        How many a task may cost before it is given up; 0 where the engine cannot be opened anew.
    advice : str
        What the user can do when a task is given up.
    """

    def __init__(
        self,
        open_engine: Callable[[], AbstractContextManager[Executor]],
        workers: int | None = None,
        *,
        count_losses: Callable[[BaseException], int] = count_broken,
        most_losses: int = MOST_LOSSES,
        advice: str = "look whether workers run out of memory; fewer of them leave more for each",
    ) -> None:
        self._open_engine = open_engine
        self._count_losses = count_losses
        self._most_losses = most_losses
        self._advice = advice
        self._numerics = numerics_id()
        self._lock = threading.Lock()  # held while something is submitted or the engine changes
        self._tasks: set[_Task[Any]] = set()
        self._timeline: Timeline | None = None
        self._is_shut_down = False
        self._gives_up = False
        self._opened = ExitStack()
        self._mender = ThreadPoolExecutor(1, thread_name_prefix="mender")
        self._engine = self._opened.enter_context(open_engine())
        self.workers = workers or count_workers(self._engine)

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Have a task run on some worker; values go by position, as engines differ in keywords.

        Its future ends by `WorkerLostError` where the task has cost more workers than it may. Raise
        RuntimeError after `shutdown`, as every Executor, and TypeError for keyword arguments.
        """
        if kwargs:
            raise TypeError(f"task arguments {sorted(kwargs)} must be given by position")
        if self._is_shut_down:
            raise RuntimeError("cannot schedule new futures after shutdown")
        task = _Task(fn, args)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self._start(task)
        return task

    def share(self, value: object) -> object:
        """Return what stands for `value` among arguments; see `Workforce.share`."""
        share = getattr(self._engine, "share", None)
        return value if share is None else share(value)

    def record(self, timeline: Timeline) -> None:
        """Record from now on what becomes of tasks.

        The process on the worker's machine is the worker; of a lost one nothing is known.
        """
        self._timeline = timeline

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End as ``concurrent.futures`` documents; the engine is closed once all is done.

        Who does not wait for that calls this once more. With `cancel_futures`, what has not started
        is cancelled, and nothing retried.
        """
        self._is_shut_down = True
        tasks = list(self._tasks)
        if cancel_futures:
            self._gives_up = True
            for task in tasks:
                task.cancel()
        if wait:
            futures.wait(tasks)
            # The mender goes last: processes end with the thread that has started them.
            with self._mender, self._opened:
                pass

    def abandon(self, end: Callable[[Executor], None]) -> None:
        """Give up what runs, and retry nothing: to be called before `shutdown`."""
        self._is_shut_down = self._gives_up = True
        with self._lock:
            end(self._engine)

    def _start(self, task: _Task[T]) -> None:
        """Submit a task to the engine."""
        with self._lock:
            engine, task.since = self._engine, time.monotonic()
            try:
                inner = engine.submit(run_task, self._numerics, task.function, *task.arguments)
            except BrokenExecutor as error:  # other tasks have not heard of it yet
                self._mender.submit(self._mend, task, engine, error)
                return
            except BaseException:
                self._tasks.discard(task)
                raise
            task.inner = inner
        inner.add_done_callback(lambda done: self._finish(task, engine, done))

    def _finish(self, task: _Task[T], engine: Executor, inner: Future[TaskOutcome[T]]) -> None:
        """Pass on what became of a task; runs in whichever thread the engine has."""
        if inner.cancelled():
            if task.is_unwanted:
                task.give_up()
            else:
                task.fail(self._lost(task, "its engine gave it up"))
            return
        error = inner.exception()
        if error is None:
            ran = inner.result()
            self._note(task, "done", ran)
            note_worker(task, ran.worker)
            task.succeed(align(ran.value))
        elif self._count_losses(error) or is_shortage(error):
            self._mender.submit(self._mend, task, engine, error)
        else:
            self._note(task, "failed")
            task.fail(error)

    def _note(self, task: _Task[Any], outcome: str, ran: TaskOutcome[Any] | None = None) -> None:
        """Record what became of a task; without an answer, since it was handed to the engine."""
        timeline = self._timeline
        if timeline is None:
            return
        sent_bytes = count_bytes(task.arguments)
        if ran is None:
            elapsed_s = time.monotonic() - task.since
            timeline.record(task.name, ANY_WORKER, elapsed_s, outcome, bytes_out=sent_bytes)
            return
        received_bytes = count_bytes(ran.value)
        timeline.record(
            task.name,
            ran.worker,
            ran.seconds,
            outcome,
            bytes_in=received_bytes,
            bytes_out=sent_bytes,
        )

    def _mend(self, task: _Task[T], engine: Executor, error: BaseException) -> None:
        """Run a task again whose worker was lost, or give it up."""
        is_short = is_shortage(error)  # which breaks no engine, so that it can always be asked anew
        task.losses += self._count_losses(error) or is_short
        self._note(task, "lost")
        try:
            if self._gives_up or task.losses > (MOST_LOSSES if is_short else self._most_losses):
                raise self._lost(task, f"{task.losses} worker(s) {_say_fate(error)}")
            if isinstance(error, BrokenExecutor):
                self._reopen(engine)
            self._start(task)
        except BaseException as final:
            final.__cause__ = final.__cause__ or error
            task.fail(final)

    def _reopen(self, broken: Executor) -> None:
        """Open the engine anew, unless that has been done for another task."""
        with self._lock:
            if self._engine is broken:
                self._opened.close()
                self._engine = self._opened.enter_context(self._open_engine())

    def _lost(self, task: _Task[Any], reason: str) -> WorkerLostError:
        return WorkerLostError(f"{task.name} was not finished: {reason}", self._advice)


def _say_fate(error: BaseException) -> str:
    """Say what became of workers that could not do a task."""
    if is_shortage(error):
        return f"lacked what it needs ({type(error).__name__}: {error})"
    return "died while it ran or waited"
