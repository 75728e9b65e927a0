"""What a machine carries: refused before anything is started, with a number that it does carry."""

from __future__ import annotations

import re
import resource
import secrets
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zmq
from made_up_machine import lay_out

from hpcapp.capacity import NEEDS, check_workers, count_carried
from hpccomponent.errors import UsageError
from hpccomponent.inventory import Inventory, InventoryWorker, dump_inventory
from hpccomponent.protocol.frames import LARGEST_FRAME
from hpccomponent.protocol.keys import KeyPair, make_key_pair, write_secret
from hpccomponent.protocol.messages import PROTOCOL_VERSION, Register, encode_message
from hpccomponent.runtime.numerics import numerics_id, package_version

StartCommand = Callable[..., "subprocess.Popen[str]"]
Reconstruct = Callable[..., tuple[int, str]]


@pytest.fixture
def reconstruct(start_command: StartCommand, sphere_file: Path) -> Reconstruct:
    """Reconstruct a sphere under limits; return the exit code and what was said."""

    def run(limits: dict[int, tuple[int, int]], *options: str) -> tuple[int, str]:
        def limit() -> None:
            for kind, values in limits.items():
                resource.setrlimit(kind, values)

        job = ("reconstruct", str(sphere_file), "-o", "mesh.ply", "--grid", "32", *options)
        with start_command(*job, preexec_fn=limit) as process:
            stderr = process.communicate()[1]
        return process.returncode, stderr

    return run


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["zmq", "processes"])
def test_more_workers_than_open_files_allow_are_refused_with_a_number_that_works(
    reconstruct: Reconstruct, backend: str
) -> None:
    limits = {resource.RLIMIT_NOFILE: (64, 64)}
    code, said = reconstruct(limits, "--backend", backend, "--workers", "90")
    assert code == 2
    found = re.fullmatch(
        r"hpcapp: --workers 90: this machine carries (\d+) \(open files: .*\); use --workers \1\n",
        said,
    )
    assert found, said
    code, said = reconstruct(limits, "--backend", backend, "--workers", found[1])
    assert code == 0, said


def test_the_soft_limit_of_open_files_is_raised(reconstruct: Reconstruct) -> None:
    limits = {resource.RLIMIT_NOFILE: (24, 400)}
    assert reconstruct(limits, "--backend", "zmq", "--workers", "3")[0] == 0


def test_few_open_files_are_enough_where_nothing_is_started(reconstruct: Reconstruct) -> None:
    assert reconstruct({resource.RLIMIT_NOFILE: (24, 24)})[0] == 0
    code, said = reconstruct({resource.RLIMIT_NOFILE: (24, 24)}, "--backend", "zmq")
    assert code == 2
    assert "this machine carries none (open files" in said
    assert said.count("\n") == 1


def test_a_small_address_space_is_named_before_libraries_end_badly(
    reconstruct: Reconstruct,
) -> None:
    code, said = reconstruct({resource.RLIMIT_AS: (200 << 20, 200 << 20)})
    assert code == 2
    assert said.startswith("hpcapp: the address space of a process is limited to 200 MiB")
    assert said.count("\n") == 1


MACHINE = {"proc/meminfo": "MemAvailable: 1048576 kB\n", "proc/loadavg": "0 0 0 1/100 9\n"}


@pytest.mark.parametrize(
    ("files", "most", "reason"),
    [
        ({}, 16, "memory: 1.0 GiB free, 64 MiB for each worker"),
        ({"proc/sys/kernel/pid_max": "150\n"}, 7, "50 more by the kernel's pid_max"),
        (
            {
                "proc/self/cgroup": "0::/a\n",
                "sys/fs/cgroup/a/pids.max": "40\n",
                "sys/fs/cgroup/a/pids.current": "20\n",
            },
            2,
            "20 more by the control group's pids.max",
        ),
        (
            {
                "proc/self/cgroup": "0::/a\n",
                "sys/fs/cgroup/a/memory.max": str(200 << 20),
                "sys/fs/cgroup/a/memory.current": "0\n",
            },
            3,
            "memory: 0.2 GiB free",
        ),
    ],
)
def test_the_least_of_all_limits_counts_and_is_named(
    tmp_path: Path, files: dict[str, str], most: int, reason: str
) -> None:
    root = lay_out(tmp_path, MACHINE | files)
    found, why = count_carried("zmq", root)
    assert (found, reason in why) == (most, True)
    with pytest.raises(UsageError, match=f"workers=99: this machine carries {most} "):
        check_workers("zmq", 99, 2, root)
    assert check_workers("zmq", most, 2, root) == most


def test_a_number_that_nobody_asked_for_is_made_to_fit(tmp_path: Path) -> None:
    root = lay_out(tmp_path, MACHINE)
    assert check_workers("zmq", None, 96, root) == 16
    assert check_workers("serial", None, 1, root) == 1


def test_the_calls_of_this_machine_have_answers() -> None:
    for backend in NEEDS:
        most, reason = count_carried(backend)
        assert most >= 1, reason


MANY = 1200
MASTER = """
import functools, logging, resource, sys
from pathlib import Path
from hpcapp.backends.cluster import listen_inventory
from hpcapp.communicator import executor

# They register and say no more: on a slow machine the first would be lost before the last has come.
executor.Timing = functools.partial(executor.Timing, liveness_s=300.0)

resource.setrlimit(resource.RLIMIT_NOFILE, (128, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
with listen_inventory(Path(sys.argv[1])) as cluster:
    print("listening", flush=True)
    cluster.executor.wait_for_workers(int(sys.argv[2]), 120.0)
    print(cluster.executor.workers, flush=True)
"""


def connect(
    context: zmq.Context[zmq.Socket[bytes]],
    inventory: Inventory,
    keys: KeyPair,
    name: str,
    numerics: str,
) -> zmq.Socket[bytes]:
    """Return the socket of a component that registers, and does no more."""
    dealer = context.socket(zmq.DEALER)
    dealer.setsockopt(zmq.ROUTING_ID, name.encode())
    dealer.setsockopt(zmq.LINGER, 0)
    dealer.setsockopt(zmq.CURVE_SERVERKEY, inventory.server_public_key.encode())
    dealer.setsockopt(zmq.CURVE_PUBLICKEY, keys.public.encode())
    dealer.setsockopt(zmq.CURVE_SECRETKEY, keys.secret.encode())
    dealer.connect(inventory.bind)
    introduction = Register(
        protocol=PROTOCOL_VERSION,
        package=package_version(),
        worker=name,
        incarnation=secrets.token_hex(8),
        build="",
        numerics=numerics,
        cores=1,
        memory_bytes=1 << 30,
        largest_frame=LARGEST_FRAME,
        blob_bytes=1 << 20,
    )
    dealer.send(encode_message(introduction))
    return dealer


@pytest.fixture
def room_for_many() -> Iterator[None]:
    """Let this process have the sockets of all components."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = 3 * MANY + 200
    if before[1] < needed:
        pytest.skip(f"the hard limit of open files is {before[1]}")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(needed, before[0]), before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.slow
@pytest.mark.usefixtures("room_for_many")
def test_a_master_of_1200_workers_raises_its_low_soft_limit(tmp_path: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    master, keys = make_key_pair(), [make_key_pair() for _ in range(MANY)]
    workers = tuple(
        InventoryWorker(f"worker-{number}", "127.0.0.1", pair.public)
        for number, pair in enumerate(keys)
    )
    endpoint = f"tcp://127.0.0.1:{port}"
    inventory = Inventory("many", endpoint, master.public, master.secret, workers)
    path = tmp_path / "inventory.json"
    write_secret(path, dump_inventory(inventory))
    command = [sys.executable, "-P", "-c", MASTER, str(path), str(MANY)]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process,
        ExitStack() as stack,
    ):
        assert process.stdout is not None
        assert process.stdout.readline() == "listening\n"
        context = stack.enter_context(zmq.Context())
        context.set(zmq.MAX_SOCKETS, MANY + 10)
        numerics = numerics_id()
        for number, pair in enumerate(keys):
            stack.enter_context(connect(context, inventory, pair, f"worker-{number}", numerics))
        assert process.stdout.readline() == f"{MANY}\n"
    assert process.returncode == 0


def test_a_hard_limit_below_the_workers_of_a_cluster_is_named(tmp_path: Path) -> None:
    keys = make_key_pair()
    workers = tuple(
        InventoryWorker(f"worker-{n}", "127.0.0.1", make_key_pair().public) for n in range(100)
    )
    inventory = Inventory("many", "tcp://127.0.0.1:1", keys.public, keys.secret, workers)
    path = tmp_path / "inventory.json"
    write_secret(path, dump_inventory(inventory))
    script = MASTER.replace("(128, resource.getrlimit(resource.RLIMIT_NOFILE)[1])", "(100, 100)")
    done = subprocess.run(
        [sys.executable, "-P", "-c", script, str(path), "100"], capture_output=True, text=True
    )
    assert done.stderr.splitlines()[-1].startswith(
        "hpccomponent.errors.UsageError: a master of 100 workers needs 140 more open files, and "
    )
