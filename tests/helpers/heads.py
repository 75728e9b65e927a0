"""Heads that are folders: what `up` leaves there, points for their jobs, and who holds them."""

from __future__ import annotations

import logging
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from directions import random_directions

WAITING = "waiting for the cluster's present job"
"""Said by a job while another program holds its cluster."""
ON_WORKERS = ("--backend", "zmq")
"""However little work it is."""
HOLD = """
import sys
from hpccomponent.inventory import hold_cluster
with hold_cluster(sys.argv[1], print):
    print(flush=True)
    sys.stdin.read()
"""


def install_python(folder: Path, script: str = f'exec {sys.executable} "$@"') -> None:
    """Make the environment of a cluster's folder, with a script for its interpreter."""
    python = folder / "venv/bin/python"
    python.parent.mkdir(parents=True)
    python.write_text(f"#!/bin/sh\n{script}\n")
    python.chmod(0o755)


def write_sphere(path: Path) -> Path:
    """Write points of the unit sphere with their normals; return the file."""
    normals = random_directions(1500, 7)
    np.savetxt(path, np.hstack([normals, normals]))
    return path


@contextmanager
def held_cluster(inventory: Path) -> Iterator[None]:
    """Hold a cluster as another master would, so that jobs run and get no further."""
    with subprocess.Popen(
        [sys.executable, "-P", "-c", HOLD, str(inventory)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        yield


@contextmanager
def when_said(
    caplog: pytest.LogCaptureFixture, words: str, act: Callable[[], object]
) -> Iterator[None]:
    """Act once when something is said to the user, as a job that is watched says that it waits."""
    acts = [act]

    def look(record: logging.LogRecord) -> bool:
        if words in record.getMessage() and acts:
            acts.pop()()
        return True

    with caplog.at_level("INFO", "hpcapp"):
        caplog.handler.addFilter(look)
        yield
        caplog.handler.removeFilter(look)
    assert not acts
