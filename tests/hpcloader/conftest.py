"""Real loaders, told what to start by a catalogue of the test's own."""

from __future__ import annotations

import json
import os
import re
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

PATIENCE_S = 10.0


class Loader:
    """A loader under test; its log is read line by line, so that nothing has to be polled."""

    def __init__(self, config: Path) -> None:
        reader, self.lifeline = os.pipe()
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-P",
                "-m",
                "hpcloader",
                "run",
                "--config",
                str(config),
                "--lifeline-fd",
                str(reader),
            ],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            pass_fds=(reader,),
        )
        os.close(reader)

    def expect(self, pattern: str) -> re.Match[str]:
        """Read the log up to the first line that matches."""
        assert self.process.stderr is not None
        seen = []
        for line in self.process.stderr:
            seen.append(line)
            if match := re.search(pattern, line):
                return match
        raise AssertionError(f"{pattern!r} is not in the log:\n{''.join(seen)}")

    def component(self) -> int:
        """Wait for the component's own word, and return its process id."""
        return int(self.expect(r"ready (\d+)")[1])

    def cut_lifeline(self) -> None:
        if self.lifeline >= 0:
            os.close(self.lifeline)
            self.lifeline = -1

    def exit_code(self) -> int:
        return self.process.wait(PATIENCE_S)

    def close(self) -> None:
        self.cut_lifeline()
        self.process.kill()
        self.process.wait()
        if self.process.stderr is not None:
            self.process.stderr.close()


@pytest.fixture
def start_loader(tmp_path: Path) -> Iterator[Callable[..., Loader]]:
    """Give a function that starts a loader whose component runs the given Python code."""
    loaders: list[Loader] = []

    def start(code: str, **settings: object) -> Loader:
        command = ["{python}", "-P", "-c", code]
        catalogue = {"version": 1, "builds": [{"name": "fake", "command": command}]}
        (tmp_path / "builds.yaml").write_text(json.dumps(catalogue))
        (tmp_path / "connection.json").write_text("{}")
        loader = {
            "version": 1,
            "name": "m1",
            "connection": "connection.json",
            "catalogue": "builds.yaml",
            "restart": {"first_s": 0.01, "cap_s": 0.02, "give_up_after": 3},
        }
        (tmp_path / "loader.yaml").write_text(json.dumps(loader | settings))
        loaders.append(Loader(tmp_path / "loader.yaml"))
        return loaders[-1]

    yield start
    for loader in loaders:
        loader.close()


@pytest.fixture
def wait_gone() -> Callable[[int], None]:
    """Give a function that waits for the end of a process that is not our child."""

    def wait(pid: int) -> None:
        try:
            pidfd = os.pidfd_open(pid)
        except ProcessLookupError:
            return
        try:
            ready, _, _ = select.select([pidfd], [], [], PATIENCE_S)
            assert ready, f"process {pid} is still there"
        finally:
            os.close(pidfd)

    return wait
