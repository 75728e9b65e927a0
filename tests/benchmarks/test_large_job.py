"""A job is killed in the middle, and what it took is measured."""

from __future__ import annotations

import mmap
import os
import signal
import subprocess
import sys
from pathlib import Path

import large_job
import pytest

SIZE = 64 << 20
_HOLDS = f"""
import sys
held = b"1" * {SIZE}
print("extract: 1 of 4, 9 s each", file=sys.stderr, flush=True)
sys.stdin.readline()
"""


def test_a_job_is_killed_when_half_of_its_tiles_are_done(tmp_path: Path) -> None:
    program = "\n".join(
        # The system counts CPU time in hundredths of a second.
        ["import sys, time", "while time.process_time() < 0.1: pass"]
        + [f"print('extract: {done} of 4', file=sys.stderr, flush=True)" for done in (0, 1, 2)]
        + ["time.sleep(600)"]
    )
    command = [sys.executable, "-c", program]
    used = large_job.run(command, tmp_path, tmp_path / "mesh.ply", is_killed=True)
    assert used.exit_code == -signal.SIGKILL
    assert used.last_line == "extract: 2 of 4"
    assert used.cpu_s > 0.0


def test_a_job_that_ends_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large_job, "POLL_S", 0.01)
    program = (
        "import sys, time; held = b'1' * (64 << 20); began = time.monotonic()\n"
        f"open({str(tmp_path / 'tile')!r}, 'wb').write(b'1' * 100_000)\n"
        "while time.monotonic() < began + 0.5: pass\n"
        "print('extract: 2 of 2', file=sys.stderr); sys.exit(3)"
    )
    used = large_job.run(
        [sys.executable, "-c", program], tmp_path, tmp_path / "mesh.ply", is_killed=False
    )
    assert used.exit_code == 3
    assert used.memory > SIZE
    assert used.disk >= 100_000


def test_memory_is_that_of_children_too_without_mapped_files(tmp_path: Path) -> None:
    file = tmp_path / "mapped"
    file.write_bytes(b"1" * SIZE)
    before = large_job.look_at(os.getpid())[0]
    with (
        file.open("rb") as opened,
        mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as mapped,
        subprocess.Popen(
            [sys.executable, "-c", _HOLDS], stdin=subprocess.PIPE, stderr=subprocess.PIPE
        ) as child,
    ):
        assert sum(mapped[:: mmap.PAGESIZE]) == SIZE // mmap.PAGESIZE * ord("1")
        assert child.stderr is not None
        child.stderr.readline()
        after = large_job.look_at(os.getpid())[0]
        child.communicate(b"\n")
    assert SIZE < after - before < 1.5 * SIZE
