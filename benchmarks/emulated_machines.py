"""Emulated machines: each a loader with its component and worker, held by a CPU quota.

::

    master's machine: hpcapp reconstruct --cluster inventory.json      one group each; with links
        │ CURVE over loopback, or over a cable with a token bucket     one network namespace each,
        ├── machine 0: loader ─> component ─> worker                   all on one bridge
        └── machine 1: loader ─> component ─> worker

The loaders are started as ``hpcapp up`` starts them, and met by an inventory: nothing of the
program knows that its machines are emulated. Quotas are those of Linux' control groups.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from hpccomponent.inventory import Inventory, InventoryWorker, dump_inventory
from hpccomponent.protocol.connection import Connection, write_connection
from hpccomponent.protocol.keys import make_key_pair, write_secret

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from testbed.network import Namespace

NETWORK = "10.99.0."
BURST = "64kb"
START_CORES = 0.5  # while loaders start; a cluster's run always
QUIET = 0.02  # of a core: what a component that waits for its master stays below
START_S = 120.0
PERIOD_US = 20_000  # at the default of 100 ms, 0.2 core may wait 80 ms before a short answer
CGROUPS = Path("/sys/fs/cgroup")
SHARES = 20  # times those of others, so that what a quota grants is had on a busy machine too
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


class CpuGroup:
    """A control group for the processes of one emulated machine, held to so many cores if any."""

    def __init__(self, name: str, cores: float | None = None) -> None:
        self._folders = [root / name for root in _find_roots()]
        self._is_new = (CGROUPS / "cgroup.controllers").exists()  # version 2
        for folder in self._folders:
            folder.mkdir(parents=True)
        weight, usual = ("cpu.weight", 100) if self._is_new else ("cpu.shares", 1024)
        self._write(weight, SHARES * usual)
        self.limit(cores)

    def limit(self, cores: float | None) -> None:
        """Hold it to another quota."""
        quota = None if cores is None else round(cores * PERIOD_US)
        if self._is_new:
            self._write("cpu.max", f"{'max' if quota is None else quota} {PERIOD_US}")
            return
        self._write("cpu.cfs_quota_us", -1)  # or the kernel compares with the period before
        self._write("cpu.cfs_period_us", PERIOD_US)
        self._write("cpu.cfs_quota_us", -1 if quota is None else quota)

    @property
    def prefix(self) -> list[str]:
        """What to put before a command that shall run in here, all of its children too."""
        enter = "".join(f"echo $$ >{folder}/cgroup.procs; " for folder in self._folders)
        return ["sh", "-c", f'{enter}exec "$@"', "sh"]

    def used_s(self) -> float:
        """Return the CPU seconds of all that has run in here."""
        if self._is_new:
            lines = (self._folders[0] / "cpu.stat").read_text().splitlines()
            return 1e-6 * float(dict(line.split() for line in lines)["usage_usec"])
        return 1e-9 * float((self._folders[-1] / "cpuacct.usage").read_text())

    def is_empty(self) -> bool:
        """Whether no process is left."""
        return not (self._folders[0] / "cgroup.procs").read_text()

    def close(self) -> None:
        """Remove it; its processes must have ended."""
        for folder in self._folders:
            folder.rmdir()

    def _write(self, name: str, value: object) -> None:
        (self._folders[0] / name).write_text(str(value))


def missing_quotas() -> str:
    """Return why no group can be had here; nothing where one can."""
    if os.geteuid() != 0:
        return "CPU quotas need root"
    if not _find_roots():
        return "no control groups for the CPU here"
    name = f"hpcapp-probe-{os.getpid()}"
    try:
        with open_group(name, 0.5) as group:
            subprocess.run([*group.prefix, "true"], check=True, capture_output=True)
    except (OSError, subprocess.SubprocessError) as error:
        return f"no CPU quota can be set here: {error}"
    return ""


@contextmanager
def open_group(name: str, cores: float | None) -> Iterator[CpuGroup]:
    """Have a group for the time of a ``with`` block."""
    group = CpuGroup(name, cores)
    try:
        yield group
    finally:
        group.close()


def _find_roots() -> list[Path]:
    """Return where groups are made: one place, or one for the quota and one for the account."""
    controllers = CGROUPS / "cgroup.controllers"
    if controllers.exists():
        return (
            [CGROUPS] if "cpu" in (CGROUPS / "cgroup.subtree_control").read_text().split() else []
        )
    roots = [CGROUPS / "cpu", CGROUPS / "cpuacct"]
    if not all((root / "cgroup.procs").exists() for root in roots):
        return []
    return roots[:1] if roots[0].samefile(roots[1]) else roots


@dataclass(frozen=True)
class Machines:
    """Emulated machines that wait for a master: ``--cluster`` takes the inventory.

    `head` is what to put before the master's command.
    """

    inventory: Path
    head: list[str]
    head_group: CpuGroup
    groups: list[CpuGroup]


@contextmanager
def open_machines(
    folder: Path,
    cores: Sequence[float | None],
    head_cores: float | None,
    hidden: Path | None = None,
    link_mbit: float | None = None,
) -> Iterator[Machines]:
    """Have emulated machines for the time of a ``with`` block, all of them up and idle.

    The folder, which must not be there, receives keys and logs; a hidden one is seen by the master
    alone. Cables carry so much each way, the master's too; without a number all use loopback.
    """
    folder.mkdir(parents=True)
    name = f"hpcapp-{os.getpid()}"
    with ExitStack() as stack:
        head_group = stack.enter_context(open_group(f"{name}-head", head_cores))
        groups = [
            stack.enter_context(open_group(f"{name}-{number}", START_CORES))
            for number in range(len(cores))
        ]
        cables: list[list[str]] = [[]] * (len(cores) + 1)
        if link_mbit is not None:
            cables = stack.enter_context(_open_network(len(cores) + 1, link_mbit))
        address = "127.0.0.1" if link_mbit is None else f"{NETWORK}1"
        connections = _write_files(folder, f"tcp://{address}:{_find_port()}", len(cores))
        hide = [] if hidden is None else _hide(hidden)
        for connection, group, cable in zip(connections, groups, cables[1:], strict=True):
            prefix = [*group.prefix, *cable, *hide]
            stack.enter_context(_run_loader(connection, prefix))
        _wait_until_quiet(groups)
        for group, quota in zip(groups, cores, strict=True):
            group.limit(quota)
        head = [*head_group.prefix, *cables[0]]
        yield Machines(folder / "inventory.json", head, head_group, groups)


def _find_port() -> int:
    """Return a port that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def _write_files(folder: Path, endpoint: str, count: int) -> list[Path]:
    """Write the inventory, and what each loader is given; return the loaders' files."""
    server, configs, workers = make_key_pair(), [], []
    for number in range(count):
        keys, place = make_key_pair(), folder / f"machine-{number}"
        place.mkdir()
        worker = InventoryWorker(place.name, endpoint, keys.public)
        connection = Connection(endpoint, server.public, keys.public, keys.secret, place.name)
        write_connection(place / "connection.json", connection)
        # The machines wait idle for their master: started again at once, and never given up.
        restart = {"first_s": 0.1, "cap_s": 2.0, "give_up_after": 1000}
        settings = {"version": 1, "name": place.name, "connection": "connection.json"}
        config = place / "loader.yaml"
        config.write_text(json.dumps(settings | {"restart": restart}))  # JSON is YAML too
        configs.append(config)
        workers.append(worker)
    inventory = Inventory("emulated", endpoint, server.public, server.secret, tuple(workers))
    write_secret(folder / "inventory.json", dump_inventory(inventory))
    return configs


@contextmanager
def _run_loader(config: Path, prefix: list[str]) -> Iterator[None]:
    """Run a loader until the block ends; its lifeline tells it."""
    reader, lifeline = os.pipe()
    words = [sys.executable, "-P", "-m", "hpcloader", "run", "--config", str(config)]
    try:
        with config.with_name("log").open("wb") as log:
            loader = subprocess.Popen(
                [*prefix, *words, "--lifeline-fd", str(reader)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=(reader,),
                env=os.environ | ONE_THREAD,
                start_new_session=True,
            )
    finally:
        os.close(reader)
    try:
        yield
    finally:
        os.close(lifeline)
        loader.wait()


def _wait_until_quiet(groups: list[CpuGroup]) -> None:
    """Wait until components have been started and wait for their master."""
    deadline = time.monotonic() + START_S
    used = [0.0] * len(groups)
    while time.monotonic() < deadline:
        time.sleep(1.0)
        before, used = used, [group.used_s() for group in groups]
        grown = [now - then for now, then in zip(used, before, strict=True)]
        if all(now > 0.0 for now in used) and max(grown) < QUIET:
            return
    raise TimeoutError(f"the loaders have not come to rest in {START_S:.0f} s")


def _hide(folder: Path) -> list[str]:
    """Return what to put before a command that shall not see what is in a folder."""
    script = 'mount -t tmpfs -o size=1m none "$0" && exec "$@"'
    return ["unshare", "--mount", "sh", "-c", script, str(folder)]


@contextmanager
def _open_network(count: int, link_mbit: float) -> Iterator[list[list[str]]]:
    """Lay a cable from each of some machines to a bridge; yield the machines' prefixes."""
    rate = f"rate {link_mbit}mbit burst {BURST} latency 50ms"
    with ExitStack() as stack:
        bridge = _open_namespace(stack)
        bridge.ip("link add name bridge type bridge\nlink set bridge up\n")
        prefixes = []
        for number in range(count):
            machine = _open_namespace(stack)
            port = f"port{number}"
            bridge.ip(
                f"link add {port} type veth peer name eth0 netns {machine.pid}\n"
                f"link set {port} master bridge up\n"
            )
            machine.ip(f"addr add {NETWORK}{number + 1}/24 dev eth0\nlink set eth0 up\n")
            for end, device in ((bridge, port), (machine, "eth0")):
                shape = f"tc qdisc add dev {device} root tbf {rate}"
                subprocess.run([*end.prefix, *shape.split()], check=True)
            prefixes.append(machine.prefix)
        yield prefixes


def _open_namespace(stack: ExitStack) -> Namespace:
    namespace = Namespace()
    stack.callback(namespace.close)
    return namespace
