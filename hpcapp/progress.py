"""What a long job tells its user while it runs: stages, and how far each has come."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any, Protocol

from hpcapp.timeline import MASTER, Timeline

__all__ = ["Progress", "SilentProgress", "StageClock"]


class Progress(Protocol):
    """A display of stages."""

    def begin(self, stage: str) -> None:
        """Announce that `stage` begins."""
        ...

    def advance(self, done: int, total: int) -> None:
        """Announce that `done` of `total` parts of the current stage are finished."""
        ...

    def end(self, stage: str, seconds: float) -> None:
        """Announce that `stage` took `seconds`."""
        ...

    def show_part(self, load: Callable[[], Any]) -> None:
        """Announce that a part of the result is there.

        Parameters
        ----------
        load : callable
            Returns it, from any thread, as long as the job runs.
        """
        ...

    def wait_for_viewers(self) -> None:
        """Let who looks at parts fetch the last ones, for a bounded time: they go with the job."""
        ...


class SilentProgress:
    """A display that shows nothing."""

    def begin(self, stage: str) -> None:
        """Show nothing."""

    def advance(self, done: int, total: int) -> None:
        """Show nothing."""

    def end(self, stage: str, seconds: float) -> None:
        """Show nothing."""

    def show_part(self, load: Callable[[], Any]) -> None:
        """Show nothing."""

    def wait_for_viewers(self) -> None:
        """Wait for nobody."""


class StageClock:
    """Times the stages of a job and passes them on to a display.

    Parameters
    ----------
    timeline : Timeline, optional
        Of the job: its stages, and what backends record in it (see `Backend.record`).

    Attributes
    ----------
    seconds : dict of str to float
        How long each stage took that has ended well.

    Examples
    --------
    >>> clock = StageClock(SilentProgress())
    >>> with clock.stage("fit"):
    ...     pass
    >>> list(clock.seconds)
    ['fit']
    """

    def __init__(self, progress: Progress, timeline: Timeline | None = None) -> None:
        self.progress = progress
        self.seconds: dict[str, float] = {}
        self.timeline = timeline or Timeline()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block as the stage `name`; blocks of one name add up.

        Parameters
        ----------
        name : str
            Key of its time, in seconds, in `seconds`.
        """
        self.progress.begin(name)
        start = perf_counter()
        try:
            yield
        except BaseException:
            self.timeline.record(name, MASTER, perf_counter() - start, "failed")
            raise
        elapsed = perf_counter() - start
        self.timeline.record(name, MASTER, elapsed)
        self.seconds[name] = self.seconds.get(name, 0.0) + elapsed
        self.progress.end(name, elapsed)
