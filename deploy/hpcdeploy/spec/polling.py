"""Polling intervals and timeouts of whatever waits on machines."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta

from hpccomponent.dataclass import dataclass


def utc_now() -> datetime:
    """Return the present moment in UTC."""
    return datetime.now(UTC)


@dataclass(frozen=True, slots=True)
class Polling:
    """How often to look, and for how long.

    Parameters
    ----------
    poll_s : float
        Between two looks at the cloud; it grows to five times that.
    end_s : float
        Until a machine must be gone, with all that it holds.
    settle_s : float
        After a command that was cut short or failed: until the cloud lists what it has asked for.
    backoff_s : tuple of float
        Before each further try to get machines that were not to be had.
    total_s : float
        Until nothing more is replaced.
    now, sleep : callable
        Of the machine's own clock; simulated in tests.
    """

    poll_s: float = 1.0
    end_s: float = 600.0
    settle_s: float = 5.0
    backoff_s: tuple[float, ...] = (5.0, 20.0)
    total_s: float = 2400.0
    now: Callable[[], datetime] = utc_now
    sleep: Callable[[float], None] = time.sleep

    def looks(self, timeout_s: float) -> Iterator[None]:
        """Yield at once, then now and again until the time is over; at least twice."""
        deadline, wait = self.now() + timedelta(seconds=timeout_s), self.poll_s
        yield
        while True:
            is_last = self.now() + timedelta(seconds=wait) >= deadline
            self.sleep(wait)
            wait = min(1.3 * wait, 5 * self.poll_s)
            yield
            if is_last:
                return
