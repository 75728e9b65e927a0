"""MPI, by a real mpiexec."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.progress import Progress

RunMpi = Callable[..., "subprocess.CompletedProcess[str]"]

KILL_ONE = """
import os, signal
import hpcapp

if __name__ == "__main__":
    with hpcapp.open_executor("mpi") as backend:
        pid = backend.executor.submit(os.getpid).result()
        print("open", flush=True)
        os.kill(pid, signal.SIGKILL)
        backend.executor.submit(os.getpid).result()
        backend.executor.submit(os.getpid).result()
    print("finished")
"""


def test_the_command_gives_the_same_bytes_under_mpi(
    run_mpi: RunMpi, sphere_file: Path, tmp_path: Path
) -> None:
    done = run_mpi(
        3, "-m", "hpcapp", "reconstruct", str(sphere_file), "-o", "mpi.ply", "--grid", "32",
        "--backend", "mpi", "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["backend"], report["workers"]) == ("mpi", 2)
    run_job(JobSettings(sphere_file, str(tmp_path / "here.ply"), grid=32), Progress())
    assert (tmp_path / "mpi.ply").read_bytes() == (tmp_path / "here.ply").read_bytes()


def test_the_commands_exit_code_comes_through(run_mpi: RunMpi, tmp_path: Path) -> None:
    (tmp_path / "empty.xyz").write_text("")
    done = run_mpi(2, "-m", "hpcapp", "reconstruct", "empty.xyz", "-o", "m.ply", "--backend", "mpi")
    assert done.returncode == 3
    assert "hpcapp: empty.xyz" in done.stderr
    assert "Traceback" not in done.stderr


def test_one_process_has_no_workers(run_mpi: RunMpi, sphere_file: Path) -> None:
    done = run_mpi(
        1, "-m", "hpcapp", "reconstruct", str(sphere_file), "-o", "m.ply", "--backend", "mpi"
    )
    assert done.returncode == 2
    assert "this MPI job is one process, and has no workers" in done.stderr


def test_the_whole_job_ends_with_a_worker(run_mpi: RunMpi, tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(KILL_ONE)
    done = run_mpi(3, "script.py")
    assert done.returncode == 128 + signal.SIGKILL
    assert done.stdout.split() == ["open"]
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(shutil.which("mpiexec") is None, reason="no MPI is installed")
def test_processes_that_are_all_masters_are_refused(sphere_file: Path) -> None:
    command = ["mpiexec", "--oversubscribe", "--allow-run-as-root", "-n", "2", sys.executable]
    command += ["-m", "hpcapp", "reconstruct", str(sphere_file), "-o", "m.ply", "--backend", "mpi"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert "python -m mpi4py.futures -m hpcapp" in done.stderr
