"""What is freed is given back to the system, or kept, as the process was told."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

from hpcapp.kernels.build import load_native
from hpccomponent.runtime.process import KEPT_MEMORY

pytestmark = [
    pytest.mark.skipif(load_native() is None, reason="the numpy build leaves memory to numpy"),
    pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="not glibc"),
]

LITTLE, MEGABYTES = 100, 400

PROGRAM = f"""
from contextlib import nullcontext
import numpy as np
from hpcapp.kernels.freed_memory import (
    bound_free_memory,
    keep_memory,
    leave_for_files,
)

def print_held():
    with open("/proc/self/statm") as file:
        print(int(file.read().split()[1]) * {os.sysconf("SC_PAGE_SIZE")} / 2**20)

def take(megabytes):
    np.ones(megabytes << 17)

print_held()
with keep_memory() if %r else nullcontext():
    for give_back in bound_free_memory, leave_for_files:
        take({LITTLE})
        give_back()
        print_held()
    take({MEGABYTES})
    take({MEGABYTES})
    print_held()
    bound_free_memory()
    print_held()
    take({LITTLE})
take({LITTLE})
print_held()
"""


def grow(keep: bool, variables: dict[str, str]) -> list[float]:
    """Return the MB that a process holds more: with little free, less, much, bounded, and after."""
    command = [sys.executable, "-P", "-c", PROGRAM % keep]
    variables = {k: v for k, v in os.environ.items() if not k.startswith("MALLOC_")} | variables
    done = subprocess.run(command, env=variables, capture_output=True, text=True, check=True)
    before, *rest = (float(line) for line in done.stdout.split())
    return [held - before for held in rest]


def test_by_default_it_is_given_back() -> None:
    assert max(grow(False, {})) < MEGABYTES / 10


@pytest.mark.parametrize(("keep", "variables"), [(True, {}), (False, KEPT_MEMORY)])
def test_it_is_kept_until_it_is_much(keep: bool, variables: dict[str, str]) -> None:
    little, less, freed, bounded, end = grow(keep, variables)
    assert LITTLE * 0.9 < little < LITTLE * 1.1
    assert less < LITTLE / 10
    assert MEGABYTES * 0.9 < freed < MEGABYTES * 1.1  # the second array lay where the first did
    assert bounded < MEGABYTES / 10
    assert end < LITTLE / 10 if keep else LITTLE * 0.9 < end < LITTLE * 1.1
