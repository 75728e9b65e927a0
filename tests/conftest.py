"""Every test that leaks a thread, a child process, a socket or a file fails."""

from __future__ import annotations

import gc
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import settings

from hpccomponent.inventory import Inventory, InventoryWorker, dump_inventory
from hpccomponent.protocol.connection import Connection, write_connection
from hpccomponent.protocol.keys import make_key_pair, write_secret

# They are imported by their names: to look for doctests there would import them once more.
collect_ignore = ["helpers"]

# A shell takes SIGINT away from what it starts in the background; tests send it, and so do commands
# that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# A shared machine stalls now and then: no example is timed.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

PROC = Path("/proc/self")


def open_files() -> set[str]:
    """Name what stands behind every open descriptor: files, sockets, pipes, memory."""
    found = set()
    for descriptor in (PROC / "fd").iterdir():
        try:
            target = os.readlink(descriptor)
        except OSError:  # the descriptor of this very listing
            continue
        found.add(f"{descriptor.name} -> {target}")
    return found


def children() -> set[int]:
    """Return the ids of all child processes, of whichever thread."""
    found: set[int] = set()
    for thread in (PROC / "task").iterdir():
        with suppress(OSError):  # a thread that has ended meanwhile has left its children to others
            found.update(map(int, (thread / "children").read_text().split()))
    return found


def pytest_collection_finish() -> None:
    """Set aside what is imported by now: after each test it would be looked through again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def no_leaks(request: pytest.FixtureRequest) -> Iterator[None]:
    if not PROC.exists() or request.node.get_closest_marker("leaks_allowed"):
        yield
        return
    threads, processes, files = set(threading.enumerate()), children(), open_files()
    yield
    gc.collect()
    gc.freeze()  # what has outlived a test, modules above all, is not looked through again
    for thread in set(threading.enumerate()) - threads:
        thread.join(timeout=5)
    leaked_threads = {t.name for t in set(threading.enumerate()) - threads}
    leaked_processes = children() - processes
    leaked_files = {f for f in open_files() - files if not is_shared(f)}
    assert not leaked_threads, f"threads left running: {leaked_threads}"
    assert not leaked_processes, f"child processes left: {leaked_processes}"
    assert not leaked_files, f"files or sockets left open: {leaked_files}"


def is_shared(descriptor: str) -> bool:
    """Tell what the interpreter or a library opens once and keeps for all tests."""
    return "/dev/urandom" in descriptor or ".hypothesis" in descriptor or "/dev/null" in descriptor


class StandingCluster:
    """Loaders on loopback that run always, and the inventory by which a master finds them.

    Parameters
    ----------
    folder : pathlib.Path
        Gets ``inventory.json``, and a folder for each loader.
    names : sequence of str
        The workers'; those after `running` have died.
    before : mapping of str to sequence of str
        By a worker's name, what comes before the command of its loader.
    tasks : mapping of str to sequence of str
        By a worker's name, ``NAME=module:function`` of what it runs in place of installed tasks.
    """

    def __init__(
        self,
        folder: Path,
        names: Sequence[str],
        running: int,
        before: Mapping[str, Sequence[str]],
        tasks: Mapping[str, Sequence[str]],
    ) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.inventory = folder / "inventory.json"
        master, keys = make_key_pair(), [make_key_pair() for _ in names]
        self.endpoint = f"tcp://127.0.0.1:{port}"
        workers = tuple(
            InventoryWorker(name, "127.0.0.1", pair.public)
            for name, pair in zip(names, keys, strict=True)
        )
        written = Inventory("standing", self.endpoint, master.public, master.secret, workers)
        write_secret(self.inventory, dump_inventory(written))
        self.loaders: list[subprocess.Popen[bytes]] = []
        for name, pair in list(zip(names, keys, strict=True))[:running]:
            machine = folder / name
            machine.mkdir()
            connection = Connection(self.endpoint, master.public, pair.public, pair.secret, name)
            write_connection(machine / "connection.json", connection)
            settings = {
                "version": 1,
                "name": name,
                "connection": "connection.json",
                "tasks": list(tasks.get(name, ())),
                "restart": {"first_s": 0.05, "cap_s": 0.2},
            }
            (machine / "loader.yaml").write_text(json.dumps(settings))
            self.loaders.append(self._start(machine, before.get(name, ())))

    @staticmethod
    def _start(machine: Path, before: Sequence[str]) -> subprocess.Popen[bytes]:
        loader = [sys.executable, "-P", "-m", "hpcloader", "run", "--config", "loader.yaml"]
        with (machine / "log").open("wb") as log:
            return subprocess.Popen(
                [*before, *loader], cwd=machine, stdin=subprocess.DEVNULL, stderr=log
            )

    def components(self) -> list[int]:
        """Return the process ids of the components that run now."""
        return [
            int(pid)
            for loader in self.loaders
            for pid in (PROC.parent / f"{loader.pid}/task/{loader.pid}/children")
            .read_text()
            .split()
        ]

    def close(self) -> None:
        for loader in self.loaders:
            loader.terminate()
        for loader in self.loaders:
            loader.wait()


@pytest.fixture
def standing_cluster(tmp_path: Path) -> Iterator[Callable[..., StandingCluster]]:
    """Give a function that starts loaders, by default two, and writes their inventory."""
    started: list[StandingCluster] = []

    def start(
        folder: Path | None = None,
        names: Sequence[str] = ("head", "worker-1"),
        running: int | None = None,
        before: Mapping[str, Sequence[str]] | None = None,
        tasks: Mapping[str, Sequence[str]] | None = None,
    ) -> StandingCluster:
        count = len(names) if running is None else running
        started.append(StandingCluster(folder or tmp_path, names, count, before or {}, tasks or {}))
        return started[-1]

    yield start
    for cluster in started:
        cluster.close()
