"""Nodes that are folders of this machine: real loaders, and what becomes of them."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from process_tree import are_gone, descendants
from typed import run

NODES = ("head", "worker-1")


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state/hpcapp/clusters/desk"


@pytest.fixture
def write(state: Path, tmp_path: Path) -> Iterator[Callable[..., Path]]:
    """Write the cluster file; what stands at the end is taken down."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    path = tmp_path / "desk.yaml"

    def write(**blocks: object) -> Path:
        content = {
            "version": 1,
            "cluster": "desk",
            "provider": {"type": "local"},
            "workers": {"count": 1},
            "communicator": {"port": port},
        }
        path.write_text(json.dumps(content | blocks))
        return path

    yield write
    assert run("down", "-y", write()) == 0


def folder_of(state: Path, node: str) -> Path:
    return state / "nodes" / node / "hpcapp/desk"


def watcher_of(state: Path, node: str) -> int:
    return int((folder_of(state, node) / "loader.pid").read_text().split()[0])


def kill(pid: int) -> None:
    """Kill a process that is not our child, and wait until it is gone."""
    os.kill(pid, signal.SIGKILL)
    assert are_gone({pid})


def wait_for_worker(state: Path, node: str) -> set[int]:
    """Return what the watcher of a node has started, once its worker runs."""
    watcher = watcher_of(state, node)
    while not any(map(is_worker, found := descendants(watcher))):
        time.sleep(0.02)  # between two looks: nothing tells of a grandchild
    return found


def is_worker(pid: int) -> bool:
    with suppress(OSError):
        return b"hpccomponent.runtime.worker" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


NO_PYTHON = "no Python >=3.99 (found: 3."


@pytest.mark.parametrize("verb", [("doctor",), ("plan",), ("up", "-y")], ids=lambda verb: verb[0])
def test_a_python_that_will_not_do_is_told_before_anything_is_made(
    write: Callable[..., Path],
    state: Path,
    capsys: pytest.CaptureFixture[str],
    verb: tuple[str, ...],
) -> None:
    assert run(*verb, write(env={"python": ">=3.99"})) == 4
    told = capsys.readouterr()
    assert NO_PYTHON in told.out + told.err
    assert not state.exists()


def test_a_roll_back_ends_and_its_reason_is_the_last_line(
    write: Callable[..., Path], state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("up", "-y", "--skip-checks", write(env={"python": ">=3.99"})) == 4
    lines = capsys.readouterr().err.splitlines()
    assert NO_PYTHON in lines[-1]
    begun = [line for line in lines if line.startswith("taking away again what was made: ")]
    assert NO_PYTHON in begun[0], "it is told even where somebody interrupts"
    assert sum(line.startswith("terminating ") for line in lines) == 1
    assert not [*(state / "nodes").iterdir()]


def test_what_is_deleted_on_a_machine_is_mended_by_up(
    write: Callable[..., Path], state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write()
    assert run("up", "-y", file) == 0
    for lost in ("venv", "connection.json", "loader.yaml"):
        before = watcher_of(state, "worker-1"), watcher_of(state, "head")
        wait_for_worker(state, "worker-1")
        place = folder_of(state, "worker-1") / lost
        shutil.rmtree(place) if place.is_dir() else place.unlink()
        capsys.readouterr()
        assert run("up", "-y", file) == 0
        told = capsys.readouterr().err
        assert "worker-1: its loader runs" in told
        assert "head: its loader runs" not in told
        assert watcher_of(state, "worker-1") != before[0]
        assert watcher_of(state, "head") == before[1]
        assert place.exists()
    assert run("status", file) == 0
    assert "not " not in capsys.readouterr().out


@pytest.mark.parametrize("victim", ["watcher", "loader"])
def test_down_ends_what_has_lost_its_parent(
    write: Callable[..., Path], state: Path, victim: str
) -> None:
    file = write()
    assert run("up", "-y", file) == 0
    below = wait_for_worker(state, "worker-1")
    kill(watcher := watcher_of(state, "worker-1"))
    if victim == "loader":
        kill(max(below, key=lambda pid: len(descendants(pid))))
    assert run("down", "-y", file) == 0
    assert not [pid for pid in below | {watcher} if is_running(pid)]


def test_up_leaves_one_loader_where_the_watcher_was_killed(
    write: Callable[..., Path], state: Path
) -> None:
    file = write()
    assert run("up", "-y", file) == 0
    orphans = wait_for_worker(state, "worker-1")
    kill(watcher := watcher_of(state, "worker-1"))
    assert run("up", "-y", file) == 0
    assert not [pid for pid in orphans if is_running(pid)]
    assert watcher_of(state, "worker-1") != watcher


def is_running(pid: int) -> bool:
    """Tell whether a process is there; one that has ended may wait for its parent."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False
