"""`up` killed with -9 at drawn points: afterwards `up` or `down` leaves no orphan, no duplicate."""

from __future__ import annotations

import os
import random
import signal
import threading

import pytest
from cloud import Call
from testbed.machine import Machine
from testbed.sites import Site

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

POINTS_OF_DEATH = 4
SEED = 20


class Steps:
    """Counts the calls and the commands on machines, and kills at one of them."""

    def __init__(self, site: Site) -> None:
        self.count = 0
        self._fatal: int | None = None
        self._pid = 0
        self._lock = threading.Lock()
        site.bed.hook = self._on_call
        site.bed.on_line = self._on_line

    def arm(self, fatal: int | None, pid: int) -> None:
        with self._lock:
            self.count, self._fatal, self._pid = 0, fatal, pid

    def _on_call(self, call: Call, moment: str) -> None:
        self._step()

    def _on_line(self, machine: Machine, line: str) -> None:
        if line.startswith("Starting session"):
            self._step()

    def _step(self) -> None:
        with self._lock:
            self.count += 1
            if self.count == self._fatal:
                os.kill(self._pid, signal.SIGKILL)


def test_killed_at_any_point(idle_site: Site) -> None:
    idle_site.write(workers={"count": 0})
    steps = Steps(idle_site)
    idle_site.succeed("up", "-y")
    total = steps.count
    idle_site.end()
    assert total > POINTS_OF_DEATH
    drawn = random.Random(SEED).sample(range(1, total * 9 // 10), POINTS_OF_DEATH)  # noqa: S311
    for number, fatal in enumerate(sorted(drawn)):
        process = idle_site.start("up", "-y")
        steps.arm(fatal, process.pid)
        process.communicate()
        steps.arm(None, 0)
        assert process.returncode == -signal.SIGKILL, f"step {fatal} of {total}"
        if number % 2:
            idle_site.succeed("up", "-y")
            assert len(idle_site.bed.cloud.living) == 1, f"step {fatal} of {total}"
        idle_site.end()
