"""Connections that have not named the token yet: few, and for a short time.

A connection is unauthenticated until one of its requests has the token. So idle connections,
however many, take neither places nor open files from those who watch the job.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

MOST_UNAUTHENTICATED = 128
"""At once; of more, the oldest is closed."""

PATIENCE_S = 5.0  # until a connection's first request

Client = tuple[str, int] | None
"""Host and port, as the scope of a request has them."""


class UnauthenticatedConnections:
    """The connections that have not named the token yet; used in the server's thread alone."""

    def __init__(self) -> None:
        self._transports: dict[Client, asyncio.Transport] = {}

    def add(self, client: Client, transport: asyncio.Transport) -> None:
        """Track a connection."""
        self._transports[client] = transport
        if len(self._transports) > MOST_UNAUTHENTICATED:
            self._close(next(iter(self._transports)), None)
        asyncio.get_running_loop().call_later(PATIENCE_S, self._close, client, transport)

    def discard(self, client: Client) -> None:
        """Track a connection no longer: it has the token, or is over."""
        self._transports.pop(client, None)

    def _close(self, client: Client, transport: asyncio.Transport | None) -> None:
        """Close a connection; not another one that has come from the same address since."""
        current = self._transports.get(client)
        if current is not None and transport in (None, current):
            self.discard(client)
            current.abort()


class TrackedProtocol(H11Protocol):
    """A connection, unauthenticated at first."""

    def __init__(
        self,
        connections: UnauthenticatedConnections,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._connections = connections

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Track it."""
        super().connection_made(transport)
        self._connections.add(self.client, transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._connections.discard(self.client)
        super().connection_lost(exc)
