"""Whole jobs out of core among machines that lie or die: lying_jobs.py [--points 200000].

Each job is a reconstruction through a folder on three machines with loaders, every answer verified.
Of these one tells a lie about all tasks of a subject, or fails at them with a text of 3 MB that is
full of orders to a terminal. Two more jobs lose Dask's scheduler and their own master, and are
resumed. All are held against the mesh of one process.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

HELPERS = Path(__file__).parents[1] / "tests" / "helpers"
sys.path.insert(0, str(HELPERS))

from lying_tasks import TASKS, list_tasks  # noqa: E402
from standing import StandingCluster, StandingDask  # noqa: E402

from hpcapp.geometry.points import PointCloud  # noqa: E402
from hpcapp.io import write_points  # noqa: E402
from hpcapp.lab.simulate.scanner import simulate_scan  # noqa: E402
from hpcapp.lab.simulate.settings import ScanSettings  # noqa: E402
from hpcapp.lab.simulate.shapes import SHAPES  # noqa: E402

SUBJECTS = ("reading", "cloud", "cleaning", "normals", "tiles")
LIES = ("zero", "plus one", "times 1.001", "failure")
ORDERS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]")
MOST_TEXT = 20_000  # characters that a job may say


def command(scan: Path, mesh: Path, *options: str) -> list[str]:
    """Return the command of a job through a folder."""
    place = ["--temp-dir", str(mesh.with_suffix(".temp")), "--max-memory", "256M"]
    program = [sys.executable, "-P", "-m", "hpcapp", "reconstruct"]
    return [*program, str(scan), "-o", str(mesh), "--grid", "96", *place, *options]


def run_lying(scan: Path, folder: Path, lie: str, subject: str, truth: bytes) -> list[str]:
    """Return a row: the lie, its subject, what was found, and whether the mesh is the true one."""
    os.environ |= {"PYTHONPATH": str(HELPERS), "LIE": lie, "LIE_ABOUT": list_tasks(subject)}
    names, mesh = ("head", "worker-1", "liar"), folder / "mesh.ply"
    cluster = StandingCluster(folder, names, len(names), {}, {"liar": TASKS})
    try:
        options = ("--cluster", str(cluster.inventory), "--backend", "zmq", "--verify", "1")
        told = subprocess.run(
            command(scan, mesh, *options, "--json"), capture_output=True, text=True
        )
    finally:
        cluster.close()
    if ORDERS.search(told.stderr + told.stdout) or len(told.stderr) > MOST_TEXT:
        return [lie, subject, "a terminal is told what to do", "no"]
    found = "nothing"
    if told.returncode == 0 and json.loads(told.stdout)["verification"]["liars"]:
        found = "a liar, turned away"
    elif "liar gets no more" in told.stderr:
        found = "a machine that fails, retired"
    return [lie, subject, found, say_same(told, mesh, truth)]


def say_same(told: subprocess.CompletedProcess[str], mesh: Path, truth: bytes) -> str:
    """Say whether a job has made the true mesh, else how it ended."""
    if told.returncode:
        return told.stderr.strip().splitlines()[-1][:200]
    return "yes" if mesh.read_bytes() == truth else "no"


def run_until_killed(arguments: list[str], victim: int | None) -> str:
    """Kill a process, or the job itself, before the first tile; return what the job says of it."""
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True) as job:
        assert job.stderr is not None
        said = ""
        for line in job.stderr:
            said = line
            if line.startswith("partition: done"):
                os.kill(victim or job.pid, signal.SIGKILL)
    return said.strip()[:200] if job.returncode > 0 else "nobody is left to say it"


def run_killed(scan: Path, folder: Path, what: str, truth: bytes) -> list[str]:
    """Return a row: what was killed, how the job ended, and whether it came to the true mesh."""
    mesh = folder / "mesh.ply"
    if what == "master":
        backend = ["--backend", "zmq", "--workers", "2"]
        end = run_until_killed(command(scan, mesh, *backend), None)
    else:
        dask = StandingDask(folder)
        try:
            backend = ["--backend", f"dask={dask.address}"]
            end = run_until_killed(command(scan, mesh, *backend), dask.scheduler.pid)
        finally:
            dask.close()
        backend = ["--backend", "zmq", "--workers", "2"]
    resumed = subprocess.run(
        command(scan, mesh, *backend, "--resume"), capture_output=True, text=True
    )
    return [f"{what} killed", "all", end, say_same(resumed, mesh, truth)]


def main() -> None:
    """Print the results as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=200_000)
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cloud = simulate_scan(SHAPES["torus"], ScanSettings(points=options.points, noise=0.002))
        scan = folder / "scan.ply"
        write_points(scan, PointCloud(cloud.positions, None))
        subprocess.run(command(scan, folder / "truth.ply", "--backend", "serial"), check=True)
        truth = (folder / "truth.ply").read_bytes()
        for lie in LIES:
            for subject in SUBJECTS:
                (place := folder / f"{lie}-{subject}").mkdir()
                rows.append(run_lying(scan, place, lie, subject, truth))
                sys.stderr.write(f"{rows[-1]}\n")
        for what in ("dask scheduler", "master"):
            (place := folder / what).mkdir()
            rows.append(run_killed(scan, place, what, truth))
            sys.stderr.write(f"{rows[-1]}\n")
    columns = ["what happens", "to tasks of", "found", "the true mesh"]
    print(json.dumps({"columns": columns, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
