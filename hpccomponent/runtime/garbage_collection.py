"""A program that hardly ever looks for cycles among its objects.

Used by the master's command, the loader, the component and the worker as they start: never by what
is imported into another program.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_OBJECTS_BETWEEN = 100_000


@contextmanager
def rare_collections() -> Iterator[None]:
    """Let this process collect cycles rarely, and at its exit none.

    Modules and arrays make hardly any, and what they hold is given back without: looking for them
    costs a twentieth of a small job, and at the exit 50 ms for all that was loaded.
    """
    gc.set_threshold(_OBJECTS_BETWEEN)
    try:
        yield
    finally:
        gc.freeze()
