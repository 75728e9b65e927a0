"""A master that is not on the head: its workers reach it through SSH and the head's relay."""

from __future__ import annotations

import asyncio
import json
import logging
import math
import queue
import shlex
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError
from hpccomponent.files.held_folders import temporary_folder
from hpccomponent.files.paths import home_folder
from hpccomponent.foreign_json import decode
from hpcdeploy.login.shell import Shell
from hpcdeploy.reconcile.cluster import open_cluster
from hpcdeploy.spec.layout import machine_folder
from hpcdeploy.tunnel.relay import BEAT_S, WANTED, Pair, closing, splice

log = logging.getLogger("hpcapp")

ANSWER_S = 60.0
"""Until the relay on the head says its port, or why it has none."""
_ENDED_S = 60.0  # until its thread has ended
MOST_SHOWN = 200  # characters of a line

Lead = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True, slots=True)
class _RelayLine:
    """A line of the relay: one of these."""

    port: Annotated[int, Meta(ge=1, le=65535)] | None = None
    error: str | None = None
    waiting: str | None = None


@contextmanager
def open_remote_inventory(path: Path) -> Iterator[tuple[Path, Lead | None]]:
    """Yield the inventory of a cluster that is up, and what leads its workers to this machine.

    `path` is the cluster file. The inventory is a copy that lasts as long as the block. On the head
    it is the head's own, and there is no need of `lead_workers`: None. Raises CloudError where the
    cluster is not up, or its head cannot be reached.
    """
    from hpcdeploy.spec.cluster import read_spec

    folder = machine_folder(read_spec(path).cluster)
    own_inventory = home_folder() / folder / "inventory.json"
    if own_inventory.exists():
        yield own_inventory, None
        return
    with open_cluster(path) as cluster, temporary_folder() as temporary:
        shell = cluster.access.open(cluster.head())
        copy = temporary / "inventory.json"
        shell.get(f"{folder}/inventory.json", copy)
        copy.chmod(0o600)
        yield copy, partial(lead_workers, shell, folder)


@contextmanager
def lead_workers(shell: Shell, folder: str, endpoint: str) -> Iterator[None]:
    """Lead a cluster's workers to a master on this machine.

    The master listens at `endpoint`, ``tcp://127.0.0.1:PORT``. Raises CloudError where the relay
    does not come up.
    """
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    is_heard = threading.Event()

    def put(line: str) -> None:
        if not is_heard.is_set():  # what is said later nobody reads
            lines.put(line)

    relay = threading.Thread(
        target=_follow_relay, args=(shell, folder, put), name="relay", daemon=True
    )
    relay.start()
    try:
        inside = _wait_for_port(lines)  # interrupted, the relay ends with the shell
    finally:
        is_heard.set()
    port = shell.forward("127.0.0.1", inside)
    loop = asyncio.new_event_loop()
    try:
        control = loop.run_until_complete(asyncio.open_connection("127.0.0.1", port))
        tunnel = loop.create_task(_serve(control, port, int(endpoint.rpartition(":")[2])))
        thread = threading.Thread(target=_run, args=(loop, tunnel), name="tunnel")
        thread.start()
        try:
            yield
        finally:
            loop.call_soon_threadsafe(tunnel.cancel)
            thread.join()
        relay.join(_ENDED_S)  # it ends with its channel, which its shell closes at the latest
    finally:
        loop.close()


def _follow_relay(shell: Shell, folder: str, put: Callable[[str], None]) -> None:
    """Run the relay to its end."""
    python, inventory = f"{folder}/venv/bin/python", f"{folder}/inventory.json"
    command = f"exec {shlex.join([python, '-P', '-m', 'hpcdeploy.tunnel.relay', inventory])} 2>&1"
    said = "the relay ended"
    try:
        said = f"the relay ended ({shell.follow(command, put)})"
    except CloudError as error:
        said = str(error)
    finally:
        put(json.dumps({"error": said}))  # whoever waits for the port must not wait for ever


def _wait_for_port(lines: queue.SimpleQueue[str]) -> int:
    """Read what the relay says up to its port."""
    said: deque[str] = deque(maxlen=5)
    deadline = time.monotonic() + ANSWER_S
    while True:
        left_s = deadline - time.monotonic()
        try:
            line = lines.get(timeout=max(0.0, left_s) if left_s < math.inf else None)
        except queue.Empty:
            left_s = 0.0
        if left_s <= 0.0:  # however much it says
            raise CloudError(
                f"the relay on the head has not said its port within {ANSWER_S:.0f} s",
                "run 'hpcapp doctor'",
                "\n".join(said),
            )
        try:
            told = decode(line, _RelayLine)
        except ValueError:
            said.append(line[:MOST_SHOWN])
            continue
        if told.port is not None:
            return told.port
        if told.error is not None:
            last = f": {said[-1]}" if said else ""
            excerpt = "\n".join(said) if len(said) > 1 else ""
            raise CloudError(f"{told.error}{last}", "run 'hpcapp doctor'", excerpt)
        if told.waiting is not None:
            log.info("the cluster is in use by another program; waiting for it to end")
            deadline = math.inf  # its jobs may take hours, and Ctrl-C ends the waiting


def _run(loop: asyncio.AbstractEventLoop, tunnel: asyncio.Task[None]) -> None:
    with suppress(asyncio.CancelledError):
        loop.run_until_complete(tunnel)
    loop.run_until_complete(loop.shutdown_asyncgens())


async def _serve(control: Pair, port: int, master: int) -> None:
    """Make a way to the master for each worker that the relay announces."""
    async with closing(control) as (reader, writer):
        ways: set[asyncio.Task[None]] = set()
        beat = asyncio.ensure_future(_beat(writer))
        try:
            with suppress(OSError):
                while wanted := await reader.read(1024):
                    for _ in range(wanted.count(WANTED)):
                        way = asyncio.ensure_future(_make_way(port, master))
                        ways.add(way)
                        way.add_done_callback(ways.discard)
            log.warning("the way to the cluster's head is cut: its workers are lost to this job")
        finally:
            tasks = (beat, *ways)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


async def _beat(writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while True:
            writer.write(b".")
            await writer.drain()
            await asyncio.sleep(BEAT_S)


async def _make_way(port: int, master: int) -> None:
    with suppress(OSError):
        async with closing(await asyncio.open_connection("127.0.0.1", port)) as inside:
            await splice(inside, await asyncio.open_connection("127.0.0.1", master))
