"""Where a communicator listens, and who may come in.

Nothing heavy is imported here: workers can be invited, and start, while the master still imports
what it will compute with. What comes early waits until it answers.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from hpcapp.capacity import reserve_connections
from hpcapp.communicator.transport import RouterTransport
from hpccomponent.errors import UsageError
from hpccomponent.protocol.connection import Connection
from hpccomponent.protocol.keys import KeyPair, is_key, make_key_pair


class Listener:
    """A listening socket with a list of keys that may connect, each under one name.

    `bind` is a ZeroMQ endpoint, by default loopback and any free port. `workers` are public keys
    (Z85) that may connect, and each one's name; `allow` and `invite` add more. `keys` are the
    master's own, by default fresh ones. Raise UsageError where nothing can listen at `bind`, a key
    is malformed, or this process cannot open as many files as there are keys.
    """

    def __init__(
        self,
        bind: str = "tcp://127.0.0.1:0",
        *,
        workers: Mapping[str, str] = MappingProxyType({}),
        keys: KeyPair | None = None,
    ) -> None:
        self.names: dict[str, str] = {}
        for key, name in workers.items():
            self.allow(key, name)
        reserve_connections(len(self.names))
        self._keys = keys or make_key_pair()
        self._transport = RouterTransport(bind, self._keys, self.names.__contains__)
        self._is_answered = False

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *error: object) -> None:
        if not self._is_answered:
            self._transport.close()

    @property
    def endpoint(self) -> str:
        """Return where workers connect to."""
        return self._transport.endpoint

    @property
    def server_key(self) -> str:
        """Return the master's public key."""
        return self._keys.public

    def answer(self) -> RouterTransport:
        """Hand the socket over to who answers at it from now on, and closes it."""
        self._is_answered = True
        return self._transport

    def allow(self, public_key: str, worker: str) -> None:
        """Let a key's owner connect, as `worker` and nobody else; UsageError where it is none."""
        if not is_key(public_key):
            raise UsageError(f"{public_key!r} is not a Z85 CURVE key of 40 characters")
        self.names[public_key] = worker

    def forbid(self, public_key: str) -> None:
        """Keep the owner of `public_key` out from now on."""
        self.names.pop(public_key, None)

    def invite(self, worker: str) -> Connection:
        """Make keys for one worker, allow them, and return what its component must know."""
        keys = make_key_pair()
        self.allow(keys.public, worker)
        return Connection(self.endpoint, self.server_key, keys.public, keys.secret, worker)
