"""Small clouds in files, and the command as a process of its own."""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from multiprocessing import resource_tracker
from pathlib import Path
from types import ModuleType

import pytest
import zmq
from spheres import make_sphere
from standing import StandingDask, StartDask
from stopping import SITECUSTOMIZE

from hpcapp.cli import _run
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import write_points
from hpccomponent.cli.verbosity import Verbosity, set_verbosity

WriteCloud = Callable[..., Path]
StartCommand = Callable[..., "subprocess.Popen[str]"]
Run = Callable[..., tuple[int, str, str]]

TASKS = str(Path(__file__).parents[1] / "helpers")


@pytest.fixture(scope="module")
def tasks() -> Iterator[ModuleType]:
    """The module of the tasks, importable here and in every process that is started."""
    patch = pytest.MonkeyPatch()
    patch.syspath_prepend(TASKS)
    patch.setenv("PYTHONPATH", os.pathsep.join([TASKS, *_python_path()]))
    yield import_module("contract_tasks")
    patch.undo()


def _python_path() -> list[str]:
    return [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]


@pytest.fixture(scope="module")
def start_dask(tasks: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartDask]:
    """Give a function that starts a Dask cluster."""
    pytest.importorskip("distributed", reason="Dask is not installed")
    started: list[StandingDask] = []

    def start(workers: int = 2, variables: dict[str, str] | None = None) -> StandingDask:
        started.append(StandingDask(tmp_path_factory.mktemp("dask"), workers, variables))
        return started[-1]

    yield start
    for cluster in started:
        cluster.close()


@pytest.fixture(scope="session", autouse=True)
def standing_helpers() -> None:
    """Start what lives as long as the interpreter, before leaks are counted.

    These are the tracker of multiprocessing, and the thread that pyzmq keeps from its first
    zero-copy send on.
    """
    resource_tracker.ensure_running()
    with zmq.Context() as context, context.socket(zmq.PAIR) as one, context.socket(zmq.PAIR) as two:
        one.bind("inproc://warm-up")
        two.connect("inproc://warm-up")
        one.send(bytes(1 << 20), copy=False)
        two.recv()


@pytest.fixture
def sphere() -> PointCloud:
    """Points of the unit sphere, normals outwards."""
    return make_sphere(1500)


@pytest.fixture
def write_cloud(tmp_path: Path) -> WriteCloud:
    """Write positions and normals to a file and return its path."""

    def write(positions: FloatArray, normals: FloatArray | None, name: str = "in.ply") -> Path:
        path = tmp_path / name
        write_points(path, PointCloud(positions, normals))
        return path

    return write


@pytest.fixture
def sphere_file(sphere: PointCloud, write_cloud: WriteCloud) -> Path:
    return write_cloud(sphere.positions, sphere.normals, "sphere.ply")


@pytest.fixture
def start_command(tmp_path: Path) -> StartCommand:
    """Start ``hpcapp`` in a process group of its own, in the test's folder."""

    def start(*arguments: str, **settings: object) -> subprocess.Popen[str]:
        values: subprocess.Popen[str] = subprocess.Popen(
            [sys.executable, "-P", "-m", "hpcapp", *arguments],
            cwd=tmp_path,
            env={**os.environ, "TMPDIR": str(tmp_path)},
            text=True,
            start_new_session=True,
            **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **settings},  # type: ignore[call-overload]
        )
        return values

    return start


@pytest.fixture
def stop_after(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str], None]:
    """Have commands stop themselves once they have said some words."""
    folder = tmp_path_factory.mktemp("stopping")
    (folder / "sitecustomize.py").write_text(SITECUSTOMIZE)
    monkeypatch.setenv("PYTHONPATH", str(folder))

    def set_words(words: str) -> None:
        monkeypatch.setenv("STOP_AFTER", words)

    return set_words


@pytest.fixture
def run_mpi(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run Python with `mpi4py.futures` on so many processes, in the test's folder."""
    if shutil.which("mpiexec") is None:
        pytest.skip("no MPI is installed")
    pytest.importorskip("mpi4py", reason="mpi4py is not installed")

    def run(processes: int, *arguments: str) -> subprocess.CompletedProcess[str]:
        command = ["mpiexec", "--oversubscribe", "-n", str(processes)]
        if os.geteuid() == 0:
            command.append("--allow-run-as-root")
        command += [sys.executable, "-P", "-m", "mpi4py.futures", *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)

    return run


@pytest.fixture
def run(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Run]:
    """Run the command in this process; return its exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        code = _run(list(arguments), debug=False)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    yield run
    set_verbosity(Verbosity.NORMAL)
    logging.captureWarnings(False)
    logging.raiseExceptions = True
    logging.getLogger().handlers.clear()
