"""Real components for the tests of the communicator."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fixture_types import StartComponent

from hpcapp.communicator.executor import CommunicatorExecutor
from hpcapp.communicator.loop import Timing
from hpccomponent.protocol.connection import Connection, write_connection

TASKS_FOLDER = Path(__file__).parents[2] / "helpers"
TASKS = [
    f"contract.{name}=contract_tasks:{name}"
    for name in (
        "echo", "no_operation", "total", "fail", "append_line", "wait_for_file",
        "announce_and_wait", "kill_worker", "kill_below", "leave_work", "read_process",
        "add_to_first", "lack_below", "freeze_first",
    )
]  # fmt: skip
QUICK = Timing(heartbeat_s=0.25, liveness_s=5.0, silence_s=20.0, worker_wait_s=20.0, probe_s=0.1)


@pytest.fixture
def executor() -> Iterator[CommunicatorExecutor]:
    executor = CommunicatorExecutor(extra_tasks=TASKS, timing=QUICK)
    yield executor
    executor.__exit__(KeyboardInterrupt, None, None)


@pytest.fixture
def start_component(executor: CommunicatorExecutor, tmp_path: Path) -> Iterator[StartComponent]:
    """Start components by hand, as a loader would; they end with the test."""
    started: list[subprocess.Popen[str]] = []

    def start(name: str = "", connection: Connection | None = None) -> subprocess.Popen[str]:
        name = name or f"worker-{len(started)}"
        path = tmp_path / f"{name}-{len(started)}.json"
        write_connection(path, connection or executor.invite(name))
        command = [sys.executable, "-P", "-m", "hpccomponent", "--connection", str(path)]
        for task in TASKS:
            command += ["--task", task]
        process = subprocess.Popen(
            command,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(TASKS_FOLDER)},
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()
