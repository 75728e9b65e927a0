"""What is freed is given back to the system, or kept, as the process was told."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

from hpcapp.applications.surface.kernels.build import load_native
from hpccomponent.runtime.process import KEPT_MEMORY

pytestmark = [
    pytest.mark.skipif(load_native() is None, reason="the numpy build leaves memory to numpy"),
    pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="not glibc"),
]

LITTLE, MEGABYTES = 100, 400

PROGRAM = f"""
import numpy as np
from hpcapp.applications.surface.kernels.freed_memory import (
    bound_free_memory,
    keep_memory,
    leave_for_files,
)

def held():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * {os.sysconf("SC_PAGE_SIZE")} / 2**20

if %r:
    keep_memory()
before = held()
for give_back in bound_free_memory, leave_for_files:
    rows = np.ones({LITTLE} << 17)
    del rows
    give_back()
    print(held() - before)
for _ in range(2):
    rows = np.ones({MEGABYTES} << 17)
    del rows
print(held() - before)
bound_free_memory()
print(held() - before)
"""


def grow(keep: bool, variables: dict[str, str]) -> list[float]:
    """Return the MB that a process holds more: with little free, less, much, and bounded."""
    command = [sys.executable, "-P", "-c", PROGRAM % keep]
    variables = {k: v for k, v in os.environ.items() if not k.startswith("MALLOC_")} | variables
    done = subprocess.run(command, env=variables, capture_output=True, text=True, check=True)
    return [float(line) for line in done.stdout.split()]


def test_by_default_it_is_given_back() -> None:
    assert max(grow(False, {})) < MEGABYTES / 10


@pytest.mark.parametrize(("keep", "variables"), [(True, {}), (False, KEPT_MEMORY)])
def test_it_is_kept_until_it_is_much(keep: bool, variables: dict[str, str]) -> None:
    little, less, freed, bounded = grow(keep, variables)
    assert LITTLE * 0.9 < little < LITTLE * 1.1
    assert less < LITTLE / 10
    assert MEGABYTES * 0.9 < freed < MEGABYTES * 1.1  # the second array lay where the first did
    assert bounded < MEGABYTES / 10
