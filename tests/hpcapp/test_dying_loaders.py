"""Loaders that die at a random step of their own life, or of their component's: the job goes on.

A step is an audit event of the interpreter (an import, a file that is opened, a process that is
started, ...). A `sitecustomize` module counts them in the loaders and components, and kills the
loader at the step that the test has drawn: before it has imported or written anything, between its
start and the component's, while that imports, connects, registers and works.
"""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import pytest

from hpcapp.backends.local_cluster import LocalCluster
from hpccomponent.errors import NoWorkersError

StartCommand = Callable[..., "subprocess.Popen[str]"]

WORKERS = 3
KILLS = 10
CUSTOMIZE = """
import atexit, os, signal, sys

role = next((name for name in ("hpcloader", "hpccomponent") if name in sys.orig_argv), None)
machine = next((os.path.basename(os.path.dirname(word)) for word in sys.orig_argv
                if word.endswith("connection.json")), None)
if role and machine:
    folder = os.environ["DYING_FOLDER"]
    victims = dict(word.rsplit(":", 1) for word in os.environ.get("DYING", "").split())
    last = int(victims.get(f"{role}:{machine}", -1))
    dies_itself = role == "hpcloader" or "DYING_ITSELF" in os.environ
    steps, victim = 0, os.getpid() if dies_itself else os.getppid()

    def count(event, arguments):
        global steps
        steps += 1
        if steps == last:
            os.close(os.open(f"{folder}/{role}.{machine}.died", os.O_CREAT))
            os.kill(victim, signal.SIGKILL)

    def write():
        with open(f"{folder}/{role}.{machine}.{os.getpid()}.steps", "w") as file:
            file.write(str(steps))

    atexit.register(write)
    sys.addaudithook(count)
"""


@pytest.fixture(scope="module")
def dying(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the module that counts, and of what it writes."""
    folder = tmp_path_factory.mktemp("dying")
    (folder / "sitecustomize.py").write_text(CUSTOMIZE)
    return folder


@pytest.fixture
def counting(dying: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Have the steps of every loader and component counted that is started from here."""
    monkeypatch.setenv("PYTHONPATH", str(dying))
    monkeypatch.setenv("DYING_FOLDER", str(dying))
    for died in dying.glob("*.died"):
        died.unlink()
    return dying


@pytest.fixture
def reconstruct(
    start_command: StartCommand, sphere_file: Path, tmp_path: Path
) -> Callable[..., tuple[bytes, str]]:
    """Reconstruct the sphere with some options; return its mesh, and what the command said."""

    def run(*options: str) -> tuple[bytes, str]:
        job = ("reconstruct", str(sphere_file), "-o", "mesh.ply", "--grid", "64", *options)
        with start_command(*job) as process:
            stderr = process.communicate()[1]
        assert process.returncode == 0, stderr
        return (tmp_path / "mesh.ply").read_bytes(), stderr

    return run


@pytest.fixture(scope="module")
def known() -> dict[str, bytes | int]:
    """What one test has found for the others: the mesh, and how many steps there are."""
    return {}


def count_steps(folder: Path, role: str) -> int:
    return min(int(path.read_text()) for path in folder.glob(f"{role}.*.steps"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(KILLS))
def test_a_loader_that_dies_at_any_step_costs_its_machine_and_no_more(
    reconstruct: Callable[..., tuple[bytes, str]],
    counting: Path,
    known: dict[str, bytes | int],
    monkeypatch: pytest.MonkeyPatch,
    seed: int,
) -> None:
    zmq = ("--backend", "zmq", "--workers", str(WORKERS))
    if not known:
        known["mesh"] = reconstruct(*zmq)[0]
        for role in ("hpcloader", "hpccomponent"):
            known[role] = count_steps(counting, role)
    draw = random.Random(seed)  # noqa: S311
    victims = draw.sample(range(WORKERS), draw.randint(1, WORKERS - 1))
    roles = [draw.choice(("hpcloader", "hpccomponent")) for _ in victims]
    deaths = [
        f"{role}:machine-{machine}:{draw.randint(1, int(known[role]))}"
        for role, machine in zip(roles, victims, strict=True)
    ]
    monkeypatch.setenv("DYING", " ".join(deaths))
    mesh, said = reconstruct(*zmq)
    assert mesh == known["mesh"]
    died = {path.name for path in counting.glob("*.died")}
    assert died
    # A step that the loader or component takes as it leaves comes when nobody watches any more.
    assert said.count("ended by signal 9") <= len(died)


def test_the_first_step_is_before_anything_is_imported_or_said(
    counting: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DYING", "hpcloader:machine-0:1 hpcloader:machine-2:1")
    with LocalCluster(WORKERS) as cluster:
        assert cluster.workers == 1
        found: Future[object] = cluster.executor.submit("files.sees", ("/no/such/file", 1))
        assert found.result() is False
    assert len(list(counting.glob("*.died"))) == 2


@pytest.mark.slow
def test_a_component_that_always_dies_before_it_registers_costs_its_machine(
    counting: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("DYING", "hpccomponent:machine-1:50")
    monkeypatch.setenv("DYING_ITSELF", "1")
    with LocalCluster(2) as cluster:
        assert cluster.workers == 1
    assert "machine-1 ended with exit code 1" in caplog.text
    assert "the component failed 5 times in a row" in caplog.text


def test_when_no_loader_is_left_the_job_ends_and_says_how_each_did(
    counting: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deaths = "hpcloader:machine-0:1 hpcloader:machine-1:1 hpccomponent:machine-2:9"
    monkeypatch.setenv("DYING", deaths)
    with pytest.raises(NoWorkersError) as caught, LocalCluster(WORKERS):
        pass
    for machine in range(WORKERS):
        assert f"machine-{machine} ended by signal 9" in str(caught.value)
    assert "started" in str(caught.value)  # the last line of the third one's log


def test_a_loader_that_leaves_early_without_an_error_is_one_less(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "python"
    program.write_text(
        f'#!/bin/sh\ncase "$*" in *machine-0*) exit 0;; *) exec {sys.executable} "$@";; esac\n'
    )
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    with LocalCluster(2) as cluster:
        assert cluster.workers == 1
