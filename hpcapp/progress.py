"""What a long job tells its user while it runs: stages, and how far each has come.

::

    job ──> StageClock ──> Progress ──┬──> a display on the terminal
            times stages              ├──> a file of events
                                      ├──> the dashboard's page
                                      └──> a function of the caller
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import TYPE_CHECKING, Protocol

from hpcapp.timeline import MASTER, Timeline

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class MeshPart(Protocol):
    """What is shown of a part of a mesh, or of a whole one; v vertices, f faces."""

    @property
    def vertices(self) -> NDArray[np.float64]:
        """Positions, shape (v, 3), in length units of the input, in the local frame."""
        ...

    @property
    def faces(self) -> NDArray[np.integer]:
        """Rows of `vertices`, shape (f, 3); negative ones are vertices of other parts."""
        ...


LoadPart = Callable[[], MeshPart]
"""Returns a part of the result, from any thread, as long as the job runs."""


class ProgressObserver:
    """Is told of a job's progress; overrides what it wants to know of."""

    shows_parts = False
    """Whether it looks at parts of the result: then they come in smaller ones."""

    def on_begin(self, stage: str) -> None:
        """Take the news that a stage begins."""

    def on_advance(self, stage: str, done: int, total: int) -> None:
        """Take the news that `done` of `total` parts of the present stage are finished."""

    def on_end(self, stage: str, seconds: float) -> None:
        """Take the news that a stage has ended well."""

    def on_part(self, load: LoadPart) -> None:
        """Take the news that a part of the result is there."""

    def on_last_part(self) -> None:
        """Fetch what is still wanted of the parts, for a bounded time: they go with the job."""


class Progress:
    """Tells observers how far a job has come; without any, nobody."""

    def __init__(self, *observers: ProgressObserver) -> None:
        self._observers = observers
        self._stage = ""

    @property
    def stage(self) -> str:
        """The present stage; empty between stages."""
        return self._stage

    def begin(self, stage: str) -> None:
        """Announce that a stage begins."""
        self._stage = stage
        for observer in self._observers:
            observer.on_begin(stage)

    def advance(self, done: int, total: int) -> None:
        """Announce that `done` of `total` parts of the present stage are finished."""
        for observer in self._observers:
            observer.on_advance(self._stage, done, total)

    def end(self, stage: str, seconds: float) -> None:
        """Announce that a stage has ended well."""
        self._stage = ""
        for observer in self._observers:
            observer.on_end(stage, seconds)

    def show_part(self, load: LoadPart) -> None:
        """Announce that a part of the result is there."""
        for observer in self._observers:
            observer.on_part(load)

    @property
    def shows_parts(self) -> bool:
        """Whether anybody looks at parts of the result."""
        return any(observer.shows_parts for observer in self._observers)

    def wait_for_viewers(self) -> None:
        """Let who looks at parts fetch the last ones, for a bounded time."""
        for observer in self._observers:
            observer.on_last_part()


class StageClock:
    """Times the stages of a job, and announces them.

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
    >>> clock = StageClock(Progress())
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
        """Time the block as a stage; blocks of one name add up."""
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
