"""What becomes of memory that this process has freed: the system's again, or its own for later.

See `docs/explanation/kernels.md` for what it saves.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from hpcapp import kernels

_MOST = 1 << 28  # that waits for the next task
_PAGES = 1 << 25  # that a file is made of, at least


@contextmanager
def keep_memory() -> Iterator[None]:
    """Have this process use memory that it has freed again; give all back in the end."""
    kernels.keep_memory(True)
    try:
        yield
    finally:
        kernels.keep_memory(False)
        kernels.bound_free_memory(0)


def bound_free_memory() -> None:
    """Give the system back what memory is free, kept or not, if it is 256 MB or more.

    To be called before a task takes most of its memory.
    """
    kernels.bound_free_memory(_MOST)


def leave_for_files() -> None:
    """Give the system back what memory is free, kept or not, if it is 32 MB or more.

    To be called before a large file is written by who will need little memory: the file's pages are
    made of what this process has touched, which the system has at hand.
    """
    kernels.bound_free_memory(_PAGES)
