"""The connection file: all that a component must know to reach its master."""

from __future__ import annotations

import json
from dataclasses import asdict, field, fields
from pathlib import Path

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ConfigError
from hpccomponent.protocol.keys import is_key, read_private_json, write_secret

CONNECTION_VERSION = 1
KEYS = ("server_key", "public_key", "secret_key")


@dataclass(frozen=True, slots=True)
class Connection:
    """Where the master listens, and the keys of one worker: CURVE, in Z85.

    The endpoint is ZeroMQ's, ``tcp://HOST:PORT``; `server_key` is the master's public one; the
    worker's name is unique within the job.
    """

    endpoint: str
    server_key: str
    public_key: str
    secret_key: str = field(repr=False)
    worker: str
    version: int = CONNECTION_VERSION


def write_connection(path: Path | str, connection: Connection) -> None:
    """Write a connection as JSON that only its owner can read; OutputError where that fails."""
    write_secret(Path(path), json.dumps(asdict(connection), indent=2) + "\n")


def read_connection(path: Path | str) -> Connection:
    """Read a connection file, and trust it only if nobody else can read it.

    Raise ConfigError, which names the file and the key, where the file is missing or readable by
    group or others, or a key is missing, unknown or not as it should be.
    """
    expected = {item.name for item in fields(Connection)}
    entries = read_private_json(Path(path), CONNECTION_VERSION, expected)
    _check(path, entries)
    return Connection(**entries)


def _check(path: Path | str, entries: dict[str, object]) -> None:
    for key in KEYS:
        if not is_key(entries[key]):
            raise ConfigError(f"{path}: {key}: not a Z85 CURVE key of 40 characters")
    endpoint, worker = entries["endpoint"], entries["worker"]
    if not isinstance(endpoint, str) or "://" not in endpoint:
        raise ConfigError(f"{path}: endpoint: {endpoint!r} is not tcp://HOST:PORT")
    if not isinstance(worker, str) or not worker or len(worker) > 100 or not worker.isprintable():
        raise ConfigError(f"{path}: worker: {worker!r} is not a name of 1 to 100 characters")
