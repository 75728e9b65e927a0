"""Above the Executor seam: an application's rows become batches, and results come back in order.

Any ``concurrent.futures.Executor`` serves; only submit, result, cancel and as_completed are used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from dataclasses import field
from itertools import islice
from pathlib import Path
from typing import TypeVar

from hpcapp.cancellation import Cancellation
from hpcapp.timeline import find_worker
from hpccomponent.cli.option_names import name_option
from hpccomponent.cli.terminal import visible_text
from hpccomponent.cutting import cut_equal
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import HpcError, TaskError, WorkerLostError
from hpccomponent.runtime.background import Background, Deferred
from hpccomponent.runtime.visible_files import sees_files

Result = TypeVar("Result")

_ASKED = 2  # times, of each worker on average


@dataclass(frozen=True, slots=True, eq=False)
class Workforce:
    """An Executor and what an application must know to cut work for it.

    Parameters
    ----------
    workers : int
        How many tasks run at once.
    batches_per_worker : int
        Into how many batches each worker's share is cut: 1 for the paper's equal batches,
        more where fast workers may take more than slow ones.
    in_process : bool
        Whether tasks run in this process: then nothing is gained by handing them small parts.
    cancellation : Cancellation
        Ends waiting for results.
    """

    executor: Executor
    workers: int = 1
    batches_per_worker: int = 1
    in_process: bool = False
    cancellation: Cancellation = field(default_factory=Cancellation)
    background: Background = field(default_factory=Background, init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.in_process:
            self.background.enable()

    def cut(self, rows: int) -> list[slice]:
        """Cut `rows` rows into batches for this workforce, in order and equal to within one row."""
        return cut_equal(rows, self.workers * self.batches_per_worker)

    def share(self, value: object) -> object:
        """Offer a large value, ndarrays that must not change any more, to all workers.

        Where the Executor can, it is sent once for many tasks. Pass what this returns to them in
        its place, as an argument or within a tuple of one; the task itself gets the value. It is
        the value itself where the Executor has no ``share``. Keep it as long as tasks come with it.
        """
        share = getattr(self.executor, "share", None)
        return value if share is None else share(value)

    def defer(self, find: Callable[[], Result]) -> Deferred[Result]:
        """Leave something to be found while this process waits for results of `stream_batches`.

        `find` is that of `Deferred`; results that come meanwhile wait for it.
        """
        return self.background.defer(find)

    def sees(self, *files: Path) -> bool:
        """Ask the workers whether they see some files, so that they may use them themselves.

        An Executor does not say which worker a task will run on: each is asked twice on average,
        and who was not asked must still be able to tell. The files are as for `sees_files`, and
        must not grow meanwhile. Return whether all answers were yes: true where tasks run in this
        process, false for a path that is not UTF-8, which cannot be told to others. Raise OSError
        where this process does not see one of them itself.
        """
        sizes = tuple((str(file.resolve()), file.stat().st_size) for file in files)
        if self.in_process:
            return True
        if any(visible_text(path) != path for path, _ in sizes):
            return False
        return all(map_batches(self, sees_files, [sizes] * (_ASKED * self.workers)))


def map_batches(
    workforce: Workforce,
    task: Callable[..., Result],
    batches: Sequence[tuple[object, ...]],
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[Result]:
    """Run `task`, a registered one, once per batch; return the results in the order of the batches.

    Raise TaskError where the task raised (batches that have not started are cancelled),
    WorkerLostError where the Executor lost a worker and does not replace it, JobCancelledError
    where somebody cancelled (see `Workforce`).
    """
    results: dict[int, Result] = {}
    for index, result in stream_batches(workforce, task, batches, max(1, len(batches))):
        results[index] = result
        advance(len(results), len(batches))
    return [results[index] for index in range(len(batches))]


def stream_batches(
    workforce: Workforce,
    task: Callable[..., Result],
    batches: Iterable[tuple[object, ...]],
    at_once: int,
    makers: dict[int, str | None] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Run `task` once per batch, with so many batches in memory, and yield results as they come.

    The next batch is asked for when there is room for it. `makers` gets the worker of each batch,
    before its result is yielded, where the backend tells. Errors are those of `map_batches`.
    """
    waiting, cancellation = enumerate(batches), workforce.cancellation
    pending: dict[Future[Result], int] = {}
    try:
        with _explain(task):
            while True:
                for index, batch in islice(waiting, at_once - len(pending)):
                    cancellation.check()
                    pending[workforce.executor.submit(task, *batch)] = index
                if not pending:
                    return
                workforce.background.run_until(pending)
                done = cancellation.wait(pending)
                index = pending.pop(done)
                if makers is not None:
                    makers[index] = find_worker(done)
                yield index, done.result()
    finally:
        for future in pending:
            future.cancel()


@contextmanager
def begin_batch(
    workforce: Workforce, task: Callable[..., Result], batch: tuple[object, ...]
) -> Iterator[Callable[[], Result]]:
    """Run `task` once, while this process does something else.

    Yield what waits for the result and returns it, or raises what `map_batches` would.
    """
    with _explain(task):
        future = workforce.executor.submit(task, *batch)

    def wait() -> Result:
        with _explain(task):
            workforce.cancellation.wait([future])
            return future.result()

    try:
        yield wait
    finally:
        future.cancel()


@contextmanager
def _explain(task: Callable[..., object]) -> Iterator[None]:
    """Say which task it was that failed."""
    try:
        yield
    except HpcError:
        raise
    except BrokenExecutor as error:
        raise WorkerLostError(
            f"a worker died while it ran {task.__name__}",
            f"run again, or choose {name_option('backend', 'zmq')}",
        ) from error
    except Exception as error:
        raise TaskError(f"{task.__name__} failed: {type(error).__name__}: {error}") from error
