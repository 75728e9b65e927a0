"""Pages that are open, and how much of a job each has been told: the job's end waits for them."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from hpccomponent.clock import Clock, MonotonicClock
from hpccomponent.dataclass import dataclass

PATIENCE_S = 2.0  # with pages that ask for nothing
MOST_S = 15.0  # with all pages together
LOADING_S = 5.0  # from the page to its first request


@dataclass(slots=True)
class _Page:
    """A page that was asked for, `since` a moment in seconds of the clock.

    `streams` is how many times it is told news at present, None before the first time; `parts` is
    how many it has fetched, one after the other; `is_told` whether it knows how the job has ended.
    """

    since: float
    streams: int | None = None
    parts: int = 0
    is_told: bool = False


class Viewers:
    """The pages of a job that are open; its methods may be called from any thread.

    Open pages may ask for nothing for `patience_s` at the end, in seconds.
    """

    def __init__(self, clock: Clock | None = None, patience_s: float = PATIENCE_S) -> None:
        self._clock = clock or MonotonicClock()
        self._patience_s = patience_s
        self._pages: dict[str, _Page] = {}
        self._change = threading.Condition()

    def arrive(self) -> str:
        """Take in a page that is asked for, and return its name."""
        name = secrets.token_urlsafe(8)
        with self._changing():
            self._pages = {key: page for key, page in self._pages.items() if self._is_open(page)}
            self._pages[name] = _Page(self._clock.now())
        return name

    def attend(self, name: str) -> None:
        """Note that a page, by its name of `arrive`, is told news from now on.

        Without a name nobody waits for it.
        """
        with self._changing():
            if name:
                page = self._pages.setdefault(name, _Page(self._clock.now()))
                page.streams = (page.streams or 0) + 1

    def leave(self, name: str) -> None:
        """Note that a page is told no more."""
        with self._changing():
            if page := self._pages.get(name):
                page.streams = (page.streams or 1) - 1

    def fetch(self, name: str, part: int) -> None:
        """Note that a page has a part, and all before it."""
        with self._changing():
            if page := self._pages.get(name):
                page.parts = max(page.parts, part + 1)

    def tell_end(self, name: str) -> None:
        """Note that a page knows how the job has ended."""
        with self._changing():
            if page := self._pages.get(name):
                page.is_told = True

    def wait(self, parts: int, *, is_over: bool = False) -> bool:
        """Wait until every open page has all parts, for a bounded time; at once where none is open.

        With `is_over`, wait until they know how the job has ended, too. Return whether they have;
        else none of them asked for anything for `patience_s`, or all together have taken `MOST_S`.
        """
        end = self._clock.now() + MOST_S
        with self._change:
            while behind := self._count_behind(parts, is_over):
                remaining_s = max(0.0, end - self._clock.now())
                if not self._change.wait(min(self._patience_s, remaining_s)):
                    break
        return not behind

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Change something in the block, and wake who waits for it."""
        with self._change:
            yield
            self._change.notify_all()

    def _count_behind(self, parts: int, is_over: bool) -> int:
        """Return how many open pages lack something."""
        return sum(
            page.parts < parts or (is_over and not page.is_told)
            for page in self._pages.values()
            if self._is_open(page)
        )

    def _is_open(self, page: _Page) -> bool:
        if page.streams is None:
            return self._clock.now() < page.since + LOADING_S
        return page.streams > 0
