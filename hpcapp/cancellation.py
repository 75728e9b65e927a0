"""Ends a job from outside: another thread says so, and the job's own threads raise.

::

    any thread ── cancel() ──> Cancellation <── check_cancelled() ── kernels, batches, passes

The threads of a job know its cancellation from their context: whatever takes long calls
`check_cancelled` in between. A kernel does so every tenth of a second, and looks for signals, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, InvalidStateError, ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from contextvars import ContextVar, copy_context
from typing import Any, ParamSpec, TypeVar

from hpccomponent.errors import JobCancelledError

P = ParamSpec("P")
Result = TypeVar("Result")


class Cancellation:
    """Cancels the jobs that it was given to, from any thread.

    Examples
    --------
    >>> import hpcapp
    >>> import threading
    >>> cancel = hpcapp.Cancellation()
    >>> threading.Timer(0.0, cancel.cancel).start()
    >>> hpcapp.reconstruct(hpcapp.simulate("knot"), grid=256, cancel=cancel)
    Traceback (most recent call last):
        ...
    hpcapp.JobCancelledError: the job was cancelled
    """

    def __init__(self) -> None:
        self._signal: Future[None] = Future()

    @property
    def is_cancelled(self) -> bool:
        """Whether somebody has cancelled."""
        return self._signal.done()

    def cancel(self) -> None:
        """Have the jobs end: each raises `JobCancelledError`, and leaves nothing running."""
        with suppress(InvalidStateError):  # it is cancelled already
            self._signal.set_result(None)

    def check(self) -> None:
        """Raise `JobCancelledError` if somebody has cancelled."""
        if self._signal.done():
            raise JobCancelledError("the job was cancelled")

    @contextmanager
    def heeded(self) -> Iterator[None]:
        """Have the work of the block end, too, wherever it calls `check_cancelled`."""
        token = _heeded.set((*_heeded.get(), self))
        try:
            yield
        finally:
            _heeded.reset(token)

    def wait(self, futures: Iterable[Future[Any]]) -> Future[Any]:
        """Return one of some futures that is done, as soon as there is one.

        Raises
        ------
        JobCancelledError
            Somebody has cancelled, now or meanwhile.
        """
        self.check()
        done: Future[Any] = next(as_completed([*futures, self._signal]))
        self.check()
        return done


_heeded: ContextVar[tuple[Cancellation, ...]] = ContextVar("heeded", default=())


def check_cancelled() -> None:
    """Raise `JobCancelledError` if the job of this thread was cancelled."""
    for cancellation in _heeded.get():
        cancellation.check()


class JobThreads(ThreadPoolExecutor):
    """Threads for a part of this thread's job: they end with it, and early after an error."""

    def __init__(self, threads: int, name: str) -> None:
        super().__init__(threads, thread_name_prefix=name)
        self._stop = Cancellation()

    def submit(
        self, fn: Callable[P, Result], /, *args: P.args, **kwargs: P.kwargs
    ) -> Future[Result]:
        """Run `fn` in a thread, unless the job has ended by then."""
        context = copy_context()
        return super().submit(lambda: context.run(self._run, fn, *args, **kwargs))

    def _run(self, fn: Callable[P, Result], /, *args: P.args, **kwargs: P.kwargs) -> Result:
        with self._stop.heeded():
            check_cancelled()
            return fn(*args, **kwargs)

    def __exit__(self, kind: type[BaseException] | None, *error: Any) -> None:
        if kind is not None:
            self._stop.cancel()
        super().__exit__(kind, *error)
