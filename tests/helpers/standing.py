"""Clusters that stand before a test begins: loaders on loopback, and Dask's own processes."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from hpccomponent.inventory import Inventory, InventoryWorker, dump_inventory
from hpccomponent.protocol.connection import Connection, write_connection
from hpccomponent.protocol.keys import make_key_pair, write_secret

PROC = Path("/proc")


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
            for pid in (PROC / f"{loader.pid}/task/{loader.pid}/children").read_text().split()
        ]

    def close(self) -> None:
        for loader in self.loaders:
            loader.terminate()
        for loader in self.loaders:
            loader.wait()


StartCluster = Callable[..., StandingCluster]


def _read_address(contact: Path) -> str:
    """Return the address in a scheduler's file, once it is there as a whole."""
    while True:
        with suppress(OSError, ValueError):
            return str(json.loads(contact.read_text())["address"])
        time.sleep(0.01)  # between two looks: Dask tells of its file by nothing else


class StandingDask:
    """A Dask scheduler and its workers as processes on loopback.

    Parameters
    ----------
    folder : pathlib.Path
        Gets the scheduler's file and the processes' logs.
    workers : int
        How many, of one thread each.
    variables : dict
        Environment of all of them, for instance Dask's own settings.
    """

    def __init__(self, folder: Path, workers: int = 2, variables: dict[str, str] | None = None):
        self._folder = folder
        scratch = {"DASK_TEMPORARY_DIRECTORY": str(folder)}
        self._environment = {**os.environ, **scratch, **(variables or {})}
        contact = folder / "scheduler.json"
        protocol = "tls" if any("TLS" in name for name in variables or {}) else "tcp"
        self.scheduler = self._start(
            "scheduler", f"--protocol={protocol}", "--port=0", f"--scheduler-file={contact}",
            "--no-dashboard", "--no-jupyter",
        )  # fmt: skip
        self.workers = [
            self._start(
                "worker", f"--scheduler-file={contact}", "--nthreads=1", "--no-nanny",
                "--no-dashboard",
            )
            for _ in range(workers)
        ]  # fmt: skip
        self.address = _read_address(contact)

    def _start(self, role: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-P", "-m", "dask", role, "--host=127.0.0.1", *options]
        with (self._folder / f"{role}.log").open("ab") as log:
            return subprocess.Popen(
                command, env=self._environment, cwd=self._folder, stdout=log, stderr=log
            )

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()  # a worker that is asked to end may look for its scheduler for minutes
            process.wait()


StartDask = Callable[..., StandingDask]
