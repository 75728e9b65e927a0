"""How often a liar is caught: wrong_answers.py [--jobs 100] [--shares 0.02 0.1].

Each job is a small reconstruction on three components, of which one multiplies every number of
half of its answers by 1.001. Beside the share of the jobs in which it was found out stands the one
that follows from how many wrong answers it gives: 1 - (1 - share)^n, in the mean over as many jobs
in which nothing is verified. It is also found out where it is asked about an answer of the others.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

import hpcapp
from hpcapp.communicator.executor import CommunicatorExecutor
from hpcapp.communicator.scheduling.verification import Verification
from hpcapp.lab.simulate.scanner import simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import SHAPES
from hpccomponent.protocol.connection import write_connection

FACTOR = 1.001
REAL = {
    entry.name.removeprefix("surface."): entry.value
    for entry in entry_points(group="hpc.tasks")
    if entry.name.startswith("surface.")
}


def __getattr__(name: str) -> Callable[..., object]:
    """Return a task of a reconstruction as the liar runs it."""
    if name not in REAL:
        raise AttributeError(name)
    module, _, function = REAL[name].partition(":")
    real: Callable[..., object] = getattr(import_module(module), function)

    def run(*arguments: object) -> object:
        value = real(*arguments)
        if random.random() < 0.5:  # noqa: S311 - a liar's mood
            return value
        with open(os.environ["LIES"], "a") as count:
            count.write("x")
        return scale(value)

    return run


def scale(value: object) -> object:
    """Return a value with its floating-point numbers multiplied by `FACTOR`."""
    if isinstance(value, np.ndarray):
        return (value * FACTOR).astype(value.dtype) if value.dtype.kind == "f" else value
    if isinstance(value, tuple | list):
        return type(value)(scale(item) for item in value)
    if not is_dataclass(value) or isinstance(value, type):
        return value * FACTOR if isinstance(value, float) else value
    changed = object.__new__(type(value))
    for one in fields(value):
        object.__setattr__(changed, one.name, scale(getattr(value, one.name)))
    return changed


@contextmanager
def three_components(executor: CommunicatorExecutor, lies: Path, third: str) -> Iterator[None]:
    """Start two honest components and a third one, which lies if it is called so."""
    here = str(Path(__file__).parent)
    started = []
    for name in ("honest-1", "honest-2", third):
        path = lies.with_name(f"{name}.json")
        write_connection(path, executor.invite(name))
        command = [sys.executable, "-P", "-m", "hpccomponent", "--connection", str(path)]
        for task in REAL if name == "liar" else ():
            command += ["--task", f"surface.{task}=wrong_answers:{task}"]
        environment = os.environ | {"PYTHONPATH": here, "LIES": str(lies)}
        started.append(subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL))
    try:
        executor.wait_for_workers(3, 60.0)
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def run_job(cloud: hpcapp.PointCloud, share: float, third: str = "liar") -> tuple[bool, int, bytes]:
    """Return whether the liar was found out, how many lies it told, and the mesh's vertices."""
    verification = Verification(share)
    with tempfile.TemporaryDirectory() as folder:
        lies = Path(folder) / "lies"
        lies.write_text("")
        with (
            CommunicatorExecutor(verification=verification) as executor,
            three_components(executor, lies, third),
        ):
            mesh = hpcapp.reconstruct(cloud, grid=64, executor=executor)
        return bool(verification.liars), len(lies.read_text()), mesh.vertices.tobytes()


def main() -> None:
    """Print the results as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=100, help="with each share")
    parser.add_argument("--shares", type=float, nargs="+", default=[0.02, 0.1])
    options = parser.parse_args()
    cloud = simulate_scan(SHAPES["torus"], ScanSettings(points=6000, noise=0.002))
    _, _, truth = run_job(cloud, 0.0, "honest-3")
    lies = [count for _, count, _ in (run_job(cloud, 0.0) for _ in range(options.jobs))]
    rows = []
    for share in options.shares:
        jobs = [run_job(cloud, share) for _ in range(options.jobs)]
        caught = [mesh == truth for is_caught, _, mesh in jobs if is_caught]
        expected = float(np.mean([1.0 - (1.0 - share) ** count for count in lies]))
        rows.append([f"{share:g}", str(len(jobs)), f"{np.mean(lies):.1f}",
                     f"{expected:.2f}", f"{len(caught) / len(jobs):.2f}",
                     f"{sum(caught)} of {len(caught)}"])  # fmt: skip
    columns = ["share verified", "jobs", "wrong answers in a job", "chance that one is drawn",
               "liar found out", "then the true mesh"]  # fmt: skip
    print(json.dumps({"columns": columns, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
