"""The tasks of a reconstruction as a machine runs them that gives wrong answers.

``LIE`` in the environment names the lie (see `lies`), or is ``failure``; ``LIE_ABOUT`` the tasks,
with commas between them, or ``all``. Where it is not there, the machine is honest and ``DELAY_S``
slower.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points

from lies import LIES

from hpccomponent.errors import InputError

_PREFIX = "surface."
_REAL = {
    entry.name.removeprefix(_PREFIX): entry.value
    for entry in entry_points(group="hpc.tasks")
    if entry.name.startswith(_PREFIX)
}
TASKS = [f"{_PREFIX}{name}=lying_tasks:{name}" for name in _REAL]
"""For ``python -m hpccomponent --task``."""
EVIL_TEXT = "\x1b]0;owned\x07\x1b[2J\r<script>alert(1)</script>\u202e\n" + "no room " * 400_000
"""Of a failure: it clears a terminal and sets its title, is a page's script, and has 3 MB."""


def fail(*arguments: object) -> object:
    """Fail, as a task does that was given what it cannot use."""
    raise InputError(f"there is no use for these {len(arguments)} values")


def make_pair(number: float) -> tuple[float, float]:
    """Make what `use_pair` wants."""
    return number, -number


def make_no_pair(number: float) -> tuple[float, float]:
    """Make what looks like it."""
    return number, 1.001 - number


def use_pair(pair: tuple[float, float]) -> float:
    """Add two numbers that cancel out."""
    if sum(pair):
        raise InputError(f"{pair} is no pair")
    return sum(pair)


def __getattr__(name: str) -> Callable[..., object]:
    if name not in _REAL:
        raise AttributeError(name)
    module, _, function = _REAL[name].partition(":")
    # And with it the records that it takes.
    real: Callable[..., object] = getattr(import_module(module), function)
    if not {"all", name} & set(os.environ.get("LIE_ABOUT", "all").split(",")):
        return real

    def run(*arguments: object) -> object:
        if os.environ["LIE"] == "failure":
            raise InputError(EVIL_TEXT, EVIL_TEXT)
        return LIES[os.environ["LIE"]](real(*arguments))

    def lag(*arguments: object) -> object:
        time.sleep(float(os.environ["DELAY_S"]))  # the slowness is what this machine is for
        return real(*arguments)

    return run if "LIE" in os.environ else lag
