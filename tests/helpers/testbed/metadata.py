"""The metadata service of the test bed: one address, each machine hears about itself."""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import socket
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from testbed.machine import Machine

_TOKEN = "token-of-"  # noqa: S105 - no secret, a shibboleth


class MetadataService:
    """Answers what `find` knows of the machine with the asking address."""

    def __init__(self, listening: socket, find: Callable[[str], Machine | None]) -> None:
        self._server = _Server(listening, find)
        self._thread = threading.Thread(target=self._server.serve_forever, name="metadata")
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = False  # so that closing waits for them

    def __init__(self, listening: socket, find: Callable[[str], Machine | None]) -> None:
        address = listening.getsockname()
        super().__init__(address, _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket, self.server_address = listening, address
        self.server_name, self.server_port = address
        self.find = find


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = 10.0

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def do_PUT(self) -> None:
        """Hand out the token of IMDSv2."""
        self._answer(200, (_TOKEN + self.client_address[0]).encode())

    def do_GET(self) -> None:
        """Answer IMDSv1 (no token) and IMDSv2."""
        machine = self.server.find(self.client_address[0])
        token = self.headers.get("X-aws-ec2-metadata-token", _TOKEN + self.client_address[0])
        if machine is None or token != _TOKEN + self.client_address[0]:
            self._answer(401 if machine else 404, b"")
            return
        path = self.path.rstrip("/").removeprefix("/latest/")
        text = facts_of(machine).get(path, b"")
        self._answer(200 if text else 404, text)

    def _answer(self, status: int, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


def facts_of(machine: Machine) -> dict[str, bytes]:
    """Return what a machine is told about itself, by path."""
    facts = {
        "instance-id": machine.name,
        "local-ipv4": machine.private,
        "public-ipv4": machine.public,
        **machine.metadata,
    }
    told = {f"meta-data/{path}": text.encode() for path, text in facts.items()}
    key = {"meta-data/public-keys/0/openssh-key": machine.public_key}
    return told | key | {"user-data": machine.user_data}
