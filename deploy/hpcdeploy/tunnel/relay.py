"""Workers' connections handed on to a remote master: ``python -P -m hpcdeploy.tunnel.relay FILE``.

::

    head                                          where the master is
    ┌────────────────────────────────┐            ┌─────────────────────────────┐
    │ workers ──> relay              │  control   │ tunnel                      │
    │  (bind of    │ loopback <──────┼─ by SSH ───┤  one byte for each worker   │
    │  inventory)  └── one data ─────┼────────────┤  one data connection each ──┼──> master
    └────────────────────────────────┘            └─────────────────────────────┘

The connections are encrypted from worker to master (CURVE): the relay learns nothing, and whoever
else connects to its loopback port reaches no worker. It holds the cluster like any master, prints
its port when it does, and ends with the control connection, or when that falls silent.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from collections import deque
from collections.abc import AsyncIterator
from pathlib import Path

from hpccomponent.errors import HpcError, UsageError
from hpccomponent.inventory import hold_cluster, read_inventory

WANTED = b"w"
"""Written by the relay on the control connection: a worker waits for a data connection."""
BEAT_S = 5.0
"""How often the other end writes a byte there."""
SILENCE_S = 30.0
FIRST_WAIT_S = 60.0
CHUNK = 1 << 18

Pair = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@contextlib.asynccontextmanager
async def closing(end: Pair) -> AsyncIterator[Pair]:
    """Close a connection at the end of the block; what it still holds is dropped."""
    try:
        yield end
    finally:
        end[1].transport.abort()
        with contextlib.suppress(OSError):
            await end[1].wait_closed()


async def splice(one: Pair, other: Pair) -> None:
    """Hand everything on between two connections until either ends; close both."""
    async with closing(one), closing(other):
        tasks = [
            asyncio.ensure_future(_pour(*way)) for way in ((one[0], other[1]), (other[0], one[1]))
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        for _, writer in (one, other):
            writer.close()
        for _, writer in (one, other):
            with contextlib.suppress(OSError):
                await writer.wait_closed()  # it sends what it holds


async def _pour(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while chunk := await reader.read(CHUNK):
            writer.write(chunk)
            await writer.drain()


class _Relay:
    def __init__(self) -> None:
        self._control: asyncio.Future[Pair] = asyncio.get_running_loop().create_future()
        self._waiting: deque[Pair] = deque()

    async def run(self, host: str, port: int) -> None:
        """Serve one master until it is gone."""
        inside = await asyncio.start_server(self._on_master, "127.0.0.1", 0)
        try:
            workers = await asyncio.start_server(self._on_worker, host, port)
        except OSError as error:
            inside.close()
            raise UsageError(
                f"cannot listen on {host}:{port}: {error.strerror}", "see what else listens there"
            ) from error
        _print({"port": inside.sockets[0].getsockname()[1]})
        try:
            reader, _ = await asyncio.wait_for(asyncio.shield(self._control), FIRST_WAIT_S)
            while await asyncio.wait_for(reader.read(CHUNK), SILENCE_S):
                pass
        except (TimeoutError, OSError):
            return
        finally:
            for server in (inside, workers):
                server.close()

    def _want(self) -> None:
        self._control.result()[1].write(WANTED)

    async def _on_master(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not self._control.done():
            self._control.set_result((reader, writer))
            for _ in self._waiting:
                self._want()
        elif self._waiting:
            await splice(self._waiting.popleft(), (reader, writer))
        else:
            writer.close()

    async def _on_worker(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._waiting.append((reader, writer))
        if self._control.done():
            self._want()


async def _serve(bind: str) -> None:
    host, _, port = bind.removeprefix("tcp://").rpartition(":")
    await _Relay().run(host.strip("[]"), int(port))


def _print(entries: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(entries) + "\n")
    sys.stdout.flush()


def _main(path: Path) -> int:
    try:
        inventory = read_inventory(path)
        with hold_cluster(path, on_wait=lambda: _print({"waiting": str(path)})):
            asyncio.run(_serve(inventory.bind))
    except HpcError as error:
        _print({"error": str(error)})
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(_main(Path(sys.argv[1])))
