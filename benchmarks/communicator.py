"""Measure the communicator beside a minimal ROUTER/DEALER, in one run, CURVE on in both.

Run it as ``python benchmarks/communicator.py [--rounds N] [-o FILE]``. Two workers on
loopback; each engine is measured in a process of its own, their rounds take turns, and medians
are compared, because absolute figures drift while ratios in one run hold. The minimal peer has
no scheduler, no failure handling and no second process per worker: it is the floor that ZeroMQ
itself sets. Dask with TLS, MPI (mpi4py.futures under mpiexec) and the standard library's process
pool are measured too where they are installed; the last two send in the clear.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray
from tables import Row, parser_of, write_table

if TYPE_CHECKING:
    import zmq

WORKERS = 2
NO_OPERATIONS = 5000
ITEMS = 50_000  # of a map
ROUND_TRIPS = 300
BLOCKS, BLOCK_BYTES = 24, 8 * 1024 * 1024  # 200 MB out; a tenth of each comes back
LIMITS = {  # metric: (other engine, what the communicator must reach of its figure)
    "no-op tasks/s": {"minimal": (0.25, "at least"), "dask": (15.0, "at least")},
    "mapped items/s": {"minimal": (2.0, "at least")},
    "round trip us": {"minimal": (4.0, "at most")},
    "throughput MB/s": {"minimal": (0.7, "at least"), "dask": (2.5, "at least")},
    "growth per result": {"itself": (1.5, "at most")},
    "start s": {"minimal": (3.0, "at most"), "dask": (1.0, "at most")},
}


Block = NDArray[np.float64]


def no_operation(item: int = 0) -> None:
    """Do nothing."""


def shrink(block: Block) -> Block:
    """Return a tenth of the block."""
    return block[: len(block) // 10].copy()


class Engine(Protocol):
    """What is measured; `items` is how many a map is given."""

    items: int

    def start(self) -> None:
        """Return when both workers have answered."""

    def no_operations(self, count: int) -> None:
        """Run `count` empty tasks, all submitted at once."""

    def map_items(self, count: int) -> None:
        """Run the empty task for `count` items, in batches where the engine makes any."""

    def shrink_blocks(self, block: Block, count: int) -> int:
        """Send `block` `count` times, and return how many bytes come back, all held at once."""


class Communicator:
    """The communicator with two components."""

    items = ITEMS

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack

    def start(self) -> None:
        """Start components, and have each answer."""
        from hpcapp.communicator.executor import CommunicatorExecutor
        from hpccomponent.protocol.connection import write_connection

        module = Path(__file__).stem
        tasks = [f"bench.{name}={module}:{name}" for name in ("no_operation", "shrink")]
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
        self._executor = CommunicatorExecutor(extra_tasks=tasks)
        self._stack.callback(self._executor.shutdown)
        for number in range(WORKERS):
            path = folder / f"{number}.json"
            write_connection(path, self._executor.invite(f"worker-{number}"))
            command = [sys.executable, "-P", "-m", "hpccomponent", "--connection", str(path)]
            for task in tasks:
                command += ["--task", task]
            self._stack.enter_context(_running(command))
        self._executor.wait_for_workers(WORKERS, 60.0)
        self.no_operations(WORKERS)

    def no_operations(self, count: int) -> None:
        """Run empty tasks."""
        futures: list[Future[None]] = [
            self._executor.submit("bench.no_operation") for _ in range(count)
        ]
        for future in futures:
            future.result()

    def map_items(self, count: int) -> None:
        """Map."""
        for _ in self._executor.map("bench.no_operation", range(count)):
            pass

    def shrink_blocks(self, block: Block, count: int) -> int:
        """Send blocks."""
        futures: list[Future[Block]] = [
            self._executor.submit("bench.shrink", block) for _ in range(count)
        ]
        return _count_bytes(future.result() for future in futures)


class Minimal:
    """ROUTER and DEALER with CURVE, two requests in flight per worker, and nothing else."""

    items = ITEMS

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack

    def start(self) -> None:
        """Start both peers, and wait for their hello."""
        import zmq

        public, secret = zmq.curve_keypair()
        context = self._stack.enter_context(zmq.Context())
        self._router = self._stack.enter_context(context.socket(zmq.ROUTER))
        self._router.setsockopt(zmq.CURVE_SERVER, 1)
        self._router.setsockopt(zmq.CURVE_SECRETKEY, secret)
        port = self._router.bind_to_random_port("tcp://127.0.0.1")
        command = [sys.executable, __file__, "--peer", str(port), public.decode()]
        for _ in range(WORKERS):
            self._stack.enter_context(_running(command))
        self._peers = [self._router.recv_multipart()[0] for _ in range(WORKERS)]

    def no_operations(self, count: int) -> None:
        """Send empty requests."""
        self._exchange(b"n", b"", count)

    def map_items(self, count: int) -> None:
        """Send empty requests: it makes no batches."""
        self._exchange(b"n", b"", count)

    def shrink_blocks(self, block: Block, count: int) -> int:
        """Send blocks."""
        return sum(frame.buffer.nbytes for frame in self._exchange(b"s", block.data, count))

    def _exchange(self, kind: bytes, payload: bytes | memoryview, count: int) -> list[zmq.Frame]:
        free_slots = [peer for _ in range(2 if kind == b"s" else 64) for peer in self._peers]
        sent = 0
        results: list[zmq.Frame] = []
        while len(results) < count:
            while free_slots and sent < count:
                self._router.send_multipart([free_slots.pop(0), kind, payload], copy=False)
                sent += 1
            frames = self._router.recv_multipart(copy=False)
            free_slots.append(frames[0].bytes)
            results.append(frames[1])
        return results


def run_peer(port: str, server_key: str) -> None:
    """Be a worker of `Minimal`."""
    import zmq

    public, secret = zmq.curve_keypair()
    with zmq.Context() as context, context.socket(zmq.DEALER) as dealer:
        dealer.setsockopt(zmq.CURVE_SERVERKEY, server_key.encode())
        dealer.setsockopt(zmq.CURVE_PUBLICKEY, public)
        dealer.setsockopt(zmq.CURVE_SECRETKEY, secret)
        dealer.connect(f"tcp://127.0.0.1:{port}")
        dealer.send(b"hello")
        while True:
            kind, payload = dealer.recv_multipart(copy=False)
            if kind.bytes == b"s":
                dealer.send(shrink(np.frombuffer(payload.buffer)).data, copy=False)
            else:
                dealer.send(b"")


class Dask:
    """Dask distributed with TLS, a scheduler and two single-threaded worker processes."""

    items = ITEMS // 25  # it would take minutes

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack

    def start(self) -> None:
        """Start the cluster, and have a task answer."""
        from distributed import Client, LocalCluster, Security

        # Dask's interface is typed in parts
        cluster = LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=WORKERS,
            threads_per_worker=1,
            protocol="tls",
            security=Security.temporary(),  # type: ignore[no-untyped-call]
            dashboard_address=":0",
        )
        self._stack.enter_context(cluster)
        self._client = self._stack.enter_context(Client(cluster))  # type: ignore[no-untyped-call]
        self.no_operations(WORKERS)

    def no_operations(self, count: int) -> None:
        """Run empty tasks."""
        self._client.gather([self._client.submit(no_operation, pure=False) for _ in range(count)])

    def map_items(self, count: int) -> None:
        """Map, in the batches of 500 items that its manual recommends for cheap ones."""
        self._client.gather(
            self._client.map(no_operation, range(count), batch_size=500, pure=False)
        )

    def shrink_blocks(self, block: Block, count: int) -> int:
        """Send blocks."""
        futures = [self._client.submit(shrink, block, pure=False) for _ in range(count)]
        return _count_bytes(self._client.gather(futures))


class Pool:
    """An Executor of workers that are started with it, by pickles in the clear."""

    items = ITEMS

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack

    def start(self) -> None:
        """Start the workers, and have tasks answer."""
        self._executor = self._stack.enter_context(self._open())
        self.no_operations(WORKERS)

    def _open(self) -> Executor:
        from multiprocessing import get_context

        return ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn"))

    def no_operations(self, count: int) -> None:
        """Run empty tasks."""
        for future in [self._executor.submit(no_operation) for _ in range(count)]:
            future.result()

    def map_items(self, count: int) -> None:
        """Map."""
        for _ in self._executor.map(no_operation, range(count), chunksize=count // 32):
            pass

    def shrink_blocks(self, block: Block, count: int) -> int:
        """Send blocks."""
        futures = [self._executor.submit(shrink, block) for _ in range(count)]
        return _count_bytes(future.result() for future in futures)


class Mpi(Pool):
    """mpi4py.futures; its processes are there before it is."""

    def _open(self) -> Executor:
        from mpi4py.futures import MPIPoolExecutor

        pool: Executor = MPIPoolExecutor()
        return pool


@contextmanager
def _running(command: list[str]) -> Iterator[None]:
    paths = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    process = subprocess.Popen(command, env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)})
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def measure(make: Callable[[ExitStack], Engine]) -> dict[str, float]:
    """Start an engine, and take each figure once."""
    block = np.random.default_rng(1).random(BLOCK_BYTES // 8)
    with ExitStack() as stack:
        engine = make(stack)
        start_s = _time(engine.start)
        engine.no_operations(500)  # queues are levelled, durations learned
        trips = [_time(lambda: engine.no_operations(1)) for _ in range(ROUND_TRIPS)]
        rate = NO_OPERATIONS / _time(lambda: engine.no_operations(NO_OPERATIONS))
        engine.map_items(engine.items // 50)
        mapped = engine.items / _time(lambda: engine.map_items(engine.items))
        engine.shrink_blocks(block, 4)
        before = _peak_bytes(anew=True)
        start = perf_counter()
        returned = engine.shrink_blocks(block, BLOCKS)
        seconds = perf_counter() - start
        growth = _peak_bytes() - before
    return {
        "start s": start_s,
        "round trip us": statistics.median(trips) * 1e6,
        "no-op tasks/s": rate,
        "mapped items/s": mapped,
        "throughput MB/s": BLOCKS * BLOCK_BYTES / 1e6 / seconds,
        "growth per result": growth / returned,
    }


def _peak_bytes(anew: bool = False) -> int:
    """Return the largest resident memory of this process, from now on if `anew` (Linux)."""
    if anew:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    raise RuntimeError("the kernel does not say how much memory this process has used")


def _count_bytes(blocks: Iterable[Block]) -> int:
    return sum(block.nbytes for block in list(blocks))  # held until the last has come


def _time(action: Callable[[], None]) -> float:
    start = perf_counter()
    action()
    return perf_counter() - start


ENGINES: dict[str, Callable[[ExitStack], Engine]] = {
    "communicator": Communicator,
    "minimal": Minimal,
    "dask": Dask,
    "processes": Pool,
    "mpi": Mpi,
}


def take_round(name: str) -> dict[str, float] | None:
    """Measure one engine in a process of its own; None if it breaks off."""
    command = [sys.executable, __file__, "--engine", name]
    if name == "mpi":
        launch = ["mpiexec", "-n", str(WORKERS + 1), "--oversubscribe"]
        launch += ["--allow-run-as-root"] if os.geteuid() == 0 else []
        command = [*launch, sys.executable, "-m", "mpi4py.futures", *command[1:]]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode:
        words = ended.stderr.strip().splitlines()[-1:] or ["without a word"]
        print(f"{name}: a round was broken off: {words[0][:200]}", flush=True)
        return None
    figures: dict[str, float] = json.loads(ended.stdout.splitlines()[-1])
    if name == "mpi":
        del figures["start s"]  # mpiexec has started the workers before
    return figures


def available() -> list[str]:
    """Return the engines that are installed here, and say which are not."""
    names = list(ENGINES)
    for name, module in (("dask", "distributed"), ("mpi", "mpi4py")):
        if find_spec(module) is None or (name == "mpi" and shutil.which("mpiexec") is None):
            print(f"{name}: skipped, it is not installed")
            names.remove(name)
    return names


def main() -> None:
    """Measure, print the table, and tell which limits are missed."""
    parser = parser_of(__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--peer", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--engine", choices=ENGINES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.peer:
        run_peer(*options.peer)
    if options.engine:
        print(json.dumps(measure(ENGINES[options.engine])))
        return
    rounds: dict[str, list[dict[str, float]]] = {name: [] for name in available()}
    for _ in range(options.rounds):
        for name, taken in rounds.items():
            figures = take_round(name)
            if figures is not None:
                taken.append(figures)
    medians = {
        name: {metric: statistics.median(r[metric] for r in taken) for metric in taken[0]}
        for name, taken in rounds.items()
        if taken
    }
    judge(medians)
    print(json.dumps(medians, indent=2))
    title = "The communicator beside its peers: medians, and what it must reach of theirs"
    columns = ("measure", *medians, "communicator by others", "limits")
    notes = [f"{options.rounds} rounds, in which the engines take turns; two workers on loopback."]
    write_table(options.output, title, columns, tabulate(medians), notes)


def tabulate(medians: dict[str, dict[str, float]]) -> list[Row]:
    """Return a row for each metric."""
    rows: list[Row] = []
    for metric, limits in LIMITS.items():
        figures: list[str | float] = [
            f"{float(f'{taken[metric]:.3g}'):,g}" if metric in taken else "-"
            for taken in medians.values()
        ]
        ours = medians["communicator"][metric]
        peers = {other: medians[other][metric] for other in limits if other in medians}
        ratios = ", ".join(f"{ours / theirs:.2g} {other}" for other, theirs in peers.items())
        asked = ", ".join(
            f"{sense} {factor:g} {other}" for other, (factor, sense) in limits.items()
        )
        rows.append([metric, *figures, ratios or "-", asked])
    return rows


def judge(medians: dict[str, dict[str, float]]) -> None:
    """Print one line per limit: whether it is kept."""
    print(f"{'':16}  {'communicator':>12}  {'other':>12}  {'ratio':>6}  limit")
    for metric, limits in LIMITS.items():
        for other, (factor, sense) in limits.items():
            if other not in medians and other != "itself":
                continue
            ours = medians["communicator"][metric]
            theirs = 1.0 if other == "itself" else medians[other][metric]
            ratio = ours / theirs
            is_kept = ratio <= factor if sense == "at most" else ratio >= factor
            word = "ok" if is_kept else "MISSED"
            line = f"{metric:16}  {ours:12.2f}  {theirs:12.2f}  {ratio:6.2f}"
            print(f"{line}  {sense} {factor:g} x {other}: {word}")


if __name__ == "__main__":
    main()
