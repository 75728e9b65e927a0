"""Time as a parameter: state machines take a clock, tests turn it by hand."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """A source of monotonic time."""

    def now(self) -> float:
        """Return the present moment, in seconds from an arbitrary start."""
        ...


class MonotonicClock:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """Return the present moment, in seconds."""
        return time.monotonic()


class ManualClock:
    """A clock that stands still until it is turned.

    Examples
    --------
    >>> clock = ManualClock()
    >>> clock.advance(2.5)
    >>> clock.now()
    2.5
    """

    def __init__(self, start: float = 0.0) -> None:
        self._now = start

    def now(self) -> float:
        """Return the present moment, in seconds."""
        return self._now

    def advance(self, seconds: float) -> None:
        """Turn the clock forward by `seconds`."""
        self._now += seconds
