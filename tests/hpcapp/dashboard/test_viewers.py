"""Whom the end of a job waits for."""

from __future__ import annotations

import threading

import pytest

from hpcapp.dashboard.viewers import LOADING_S, Viewers
from hpccomponent.clock import ManualClock


def fetch_all(viewers: Viewers, name: str, parts: int) -> threading.Thread:
    """Let a page fetch all parts, from another thread."""

    def fetch() -> None:
        for part in range(parts):
            viewers.fetch(name, part)
        viewers.tell_end(name)

    thread = threading.Thread(target=fetch)
    thread.start()
    return thread


def test_nobody_is_waited_for_where_no_page_is_open() -> None:
    viewers = Viewers()
    assert viewers.wait(100, is_over=True)
    left = viewers.arrive()
    viewers.attend(left)
    viewers.leave(left)
    viewers.attend("")  # reads the news without a page
    assert viewers.wait(100, is_over=True)


def test_a_page_that_never_came_to_life_is_forgotten() -> None:
    clock = ManualClock()
    viewers = Viewers(clock)
    viewers.arrive()
    clock.advance(LOADING_S)
    assert viewers.wait(1)


def test_open_pages_get_all_parts() -> None:
    viewers = Viewers()
    names = [viewers.arrive(), viewers.arrive()]
    viewers.attend(names[0])  # the other one still loads
    threads = [fetch_all(viewers, name, 5) for name in names]
    assert viewers.wait(5, is_over=True)
    for thread in threads:
        thread.join()
    assert viewers.wait(5, is_over=True)


@pytest.mark.parametrize("is_over", [False, True])
def test_the_wait_for_a_page_that_asks_for_nothing_ends(is_over: bool) -> None:
    viewers = Viewers(patience_s=0.01)
    name = viewers.arrive()
    viewers.attend(name)
    if is_over:
        viewers.fetch(name, 0)
        assert viewers.wait(1)
    assert not viewers.wait(1, is_over=is_over)


def test_the_wait_ends_for_pages_that_are_slow() -> None:
    clock = ManualClock()
    viewers = Viewers(clock, patience_s=60.0)
    viewers.attend("slow")
    over = threading.Event()

    def fetch_for_ever() -> None:
        part = 0
        while not over.is_set():
            clock.advance(1.0)
            viewers.fetch("slow", part := part + 1)

    thread = threading.Thread(target=fetch_for_ever)
    thread.start()
    assert not viewers.wait(10**9)
    over.set()
    thread.join()
