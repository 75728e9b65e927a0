"""Ends a job from outside: another thread says so, and the job's own thread raises."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Future, InvalidStateError, as_completed
from contextlib import suppress
from typing import Any

from hpccomponent.errors import JobCancelledError


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
