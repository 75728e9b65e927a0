"""SSH servers in this process, each on an address of its own with a home of its own.

::

    test ── paramiko ──> 127.0.0.N:PORT ── asyncssh, one thread for all ──> real shells in HOME
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import asyncssh
import paramiko

T = TypeVar("T")
USER = "admin"
_CHUNK = 1 << 16


class Server:
    """One machine.

    Parameters
    ----------
    address : str
        On loopback.
    home : Path
        Where commands run and files lie.
    """

    def __init__(self, address: str, home: Path) -> None:
        self.address = address
        self.home = home
        self.port = 0
        self.keys: list[str] = []
        """Public keys that may log in."""
        self.denials = 0
        """So many logins are refused first, as before an image has installed its key."""
        self.commands: list[str] = []
        """What was run."""
        self.routes: dict[str, str] = {}
        """Addresses that are reached from this machine only, and where they lead."""
        self.path = os.environ["PATH"]
        self.host_key = asyncssh.generate_private_key("ssh-ed25519")
        self._acceptor: asyncssh.SSHAcceptor | None = None
        self._children: set[asyncio.subprocess.Process] = set()
        self._connections: set[asyncssh.SSHServerConnection] = set()

    @property
    def host_line(self) -> str:
        """The public host key, as in a ``known_hosts`` file."""
        return " ".join(self.host_key.export_public_key().decode().split()[:2])

    @property
    def known(self) -> paramiko.PKey:
        """The public host key, as a client pins it."""
        entry = paramiko.hostkeys.HostKeyEntry.from_line(f"x {self.host_line}")
        assert entry is not None
        assert entry.key is not None
        return entry.key

    @property
    def console(self) -> str:
        """What it would print at its first boot."""
        return (
            "[    1.0] booting\n-----BEGIN SSH HOST KEY KEYS-----\n"
            f"{self.host_line} root@machine\n-----END SSH HOST KEY KEYS-----\n"
        )

    async def start(self, port: int = 0) -> None:
        self.home.mkdir(parents=True, exist_ok=True)
        self._acceptor = await asyncssh.create_server(
            lambda: _Login(self),
            self.address,
            port,
            server_host_keys=[self.host_key],
            process_factory=self._run,
            encoding=None,
            line_editor=False,
            allow_scp=False,
        )
        self.port = self._acceptor.get_port()

    async def stop(self) -> None:
        """Stop answering, and cut what is open."""
        if self._acceptor is not None:
            self._acceptor.close()
            await self._acceptor.wait_closed()
            self._acceptor = None
        for connection in list(self._connections):
            connection.abort()
            await connection.wait_closed()
        for child in list(self._children):  # with what it has started in the foreground
            with suppress(ProcessLookupError):  # it has just ended
                os.killpg(child.pid, signal.SIGKILL)
            await child.wait()

    async def _run(self, process: asyncssh.SSHServerProcess[bytes]) -> None:
        command = process.command or "sh"
        self.commands.append(command)
        child = await asyncio.create_subprocess_exec(
            "/bin/sh",
            "-c",
            command,
            cwd=self.home,
            env={"HOME": str(self.home), "PATH": self.path, "LANG": "C.UTF-8"},
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
        )
        self._children.add(child)
        feeder = asyncio.create_task(_feed(child, process))
        # All output has left before the exit is told: asyncssh's own redirection leaves that open.
        await asyncio.gather(
            _pump(child.stdout, process.stdout), _pump(child.stderr, process.stderr)
        )
        code = await child.wait()
        self._children.discard(child)
        feeder.cancel()
        await asyncio.gather(feeder, return_exceptions=True)
        if code < 0:
            process.exit_with_signal("KILL")
        else:
            process.exit(code)
        await process.wait_closed()  # it keeps coroutines that want to be awaited


async def _pump(source: Any, target: Any) -> None:
    """Carry what a command says to the client, for as long as there is one."""
    while chunk := await source.read(_CHUNK):
        with suppress(OSError, asyncssh.Error):
            target.write(chunk)
            await target.drain()


async def _feed(child: asyncio.subprocess.Process, process: Any) -> None:
    """Carry what the client says to a command."""
    assert child.stdin is not None
    with suppress(OSError, asyncssh.Error):
        while chunk := await process.stdin.read(_CHUNK):
            child.stdin.write(chunk)
            await child.stdin.drain()
    child.stdin.close()


class _Login(asyncssh.SSHServer):
    def __init__(self, server: Server) -> None:
        self._server = server
        self._connection: asyncssh.SSHServerConnection | None = None

    def connection_made(self, conn: asyncssh.SSHServerConnection) -> None:
        self._connection = conn
        self._server._connections.add(conn)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._connection is not None:
            self._server._connections.discard(self._connection)

    def begin_auth(self, username: str) -> bool:
        return True

    def public_key_auth_supported(self) -> bool:
        return True

    def validate_public_key(self, username: str, key: asyncssh.SSHKey) -> bool:
        if self._server.denials > 0:
            self._server.denials -= 1
            return False
        known = [" ".join(line.split()[:2]) for line in self._server.keys]
        offered = " ".join(key.export_public_key().decode().split()[:2])
        return username == USER and offered in known

    def connection_requested(
        self, dest_host: str, dest_port: int, orig_host: str, orig_port: int
    ) -> Any:
        if dest_host not in self._server.routes:
            return True
        assert self._connection is not None
        place = self._server.routes[dest_host]
        return self._connection.forward_connection(place, dest_port)


def _is_ours(record: logging.LogRecord) -> bool:
    """Keep off stderr, where a test looks for our words, that a server here writes to nobody."""
    return record.getMessage() != "socket.send() raised exception."


class Machines:
    """All servers of a test, and the thread that serves them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="machines")
        self.servers: list[Server] = []

    def add(self, *, is_up: bool = True, port: int = 0) -> Server:
        """Make one more machine, on the next address."""
        number = len(self.servers) + 2
        server = Server(f"127.0.0.{number}", self._folder / f"home-{number}")
        self.servers.append(server)
        if is_up:
            self.start(server, port)
        return server

    def start(self, server: Server, port: int = 0) -> None:
        self.call(lambda: server.start(port))

    def stop(self, server: Server) -> None:
        self.call(server.stop)

    def call(self, function: Callable[[], Awaitable[T]]) -> T:
        """Run a coroutine in the servers' thread."""

        async def run() -> T:
            return await function()

        return asyncio.run_coroutine_threadsafe(run(), self._loop).result(30)

    async def _stop_all(self) -> None:
        for server in self.servers:
            await server.stop()
        others: set[asyncio.Task[object]] = asyncio.all_tasks() - {asyncio.current_task()}
        await asyncio.wait(others, timeout=10) if others else None

    @classmethod
    @contextmanager
    def open(cls, folder: Path) -> Iterator[Machines]:
        machines = cls(folder)
        machines._thread.start()
        log = logging.getLogger("asyncio")
        log.addFilter(_is_ours)
        try:
            yield machines
        finally:
            machines.call(machines._stop_all)
            machines._loop.call_soon_threadsafe(machines._loop.stop)
            machines._thread.join()
            machines._loop.run_until_complete(machines._loop.shutdown_asyncgens())
            machines._loop.close()
            log.removeFilter(_is_ours)
