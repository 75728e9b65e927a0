"""Connections that have not named the token yet: few, and for a short time.

Whoever connects is a stranger until a request of theirs has it. So idle connections, however many,
take neither places nor open files from those who watch the job.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

__all__ = ["MOST_STRANGERS", "Door", "Strangers"]

MOST_STRANGERS = 128
"""At once; of more, the one that has been there longest is turned away."""

PATIENCE_S = 5.0  # with a stranger's first request

Client = Any
"""Host and port, as the scope of a request has them."""


class Strangers:
    """The connections that have not named the token yet; used in the server's thread alone."""

    def __init__(self) -> None:
        self._transports: dict[Client, asyncio.Transport] = {}

    def arrive(self, client: Client, transport: asyncio.Transport) -> None:
        """Take in a connection."""
        self._transports[client] = transport
        if len(self._transports) > MOST_STRANGERS:
            self._turn_away(next(iter(self._transports)), None)
        asyncio.get_running_loop().call_later(PATIENCE_S, self._turn_away, client, transport)

    def admit(self, client: Client) -> None:
        """Let a connection stay, or forget one that is over."""
        self._transports.pop(client, None)

    def _turn_away(self, client: Client, transport: asyncio.Transport | None) -> None:
        """End a connection; not another one that has come from the same address since."""
        held = self._transports.get(client)
        if held is not None and transport in (None, held):
            self.admit(client)
            held.abort()


class Door(H11Protocol):
    """A connection, which is a stranger's at first."""

    def __init__(self, strangers: Strangers, **settings: Any) -> None:
        super().__init__(**settings)
        self._strangers = strangers

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take in a stranger."""
        super().connection_made(transport)
        self._strangers.arrive(self.client, transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._strangers.admit(self.client)
        super().connection_lost(exc)
