"""The connection file: all that a component must know to reach its master."""

from __future__ import annotations

import json
import os
import stat
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

from hpccomponent.errors import ConfigError
from hpccomponent.protocol.keys import is_key, write_secret

__all__ = ["CONNECTION_VERSION", "Connection", "read_connection", "write_connection"]

CONNECTION_VERSION = 1
KEYS = ("server_key", "public_key", "secret_key")


@dataclass(frozen=True, slots=True)
class Connection:
    """Where the master listens, and the keys of one worker.

    Parameters
    ----------
    endpoint : str
        ZeroMQ endpoint of the master, ``tcp://HOST:PORT``.
    server_key : str
        The master's public CURVE key, Z85.
    public_key, secret_key : str
        The worker's own CURVE keys, Z85.
    worker : str
        The worker's name, unique within the job.
    version : int
        Version of this file's format.
    """

    endpoint: str
    server_key: str
    public_key: str
    secret_key: str = field(repr=False)
    worker: str
    version: int = CONNECTION_VERSION


def write_connection(path: Path | str, connection: Connection) -> None:
    """Write `connection` to `path` as JSON, readable by its owner only.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_secret(Path(path), json.dumps(asdict(connection), indent=2) + "\n")


def read_connection(path: Path | str) -> Connection:
    """Read a connection file, and trust it only if nobody else can read it.

    Parameters
    ----------
    path : pathlib.Path or str
        What `write_connection` wrote.

    Returns
    -------
    Connection

    Raises
    ------
    ConfigError
        If the file is missing, is readable by group or others, or a key is missing, unknown or
        not as it should be; the message names the file and the key.
    """
    text = _read_private(Path(path))
    try:
        entries = json.loads(text)
    except ValueError as error:
        raise ConfigError(f"{path}: not JSON ({error})", "have the file written anew") from error
    if not isinstance(entries, dict):
        raise ConfigError(f"{path}: not a JSON object", "have the file written anew")
    if entries.get("version") != CONNECTION_VERSION:
        raise ConfigError(
            f"{path}: version: {entries.get('version')!r} is not {CONNECTION_VERSION}",
            "use the same release of hpcapp on both ends",
        )
    expected = {item.name for item in fields(Connection)}
    for key in sorted(expected ^ entries.keys()):
        verdict = "is missing" if key in expected else "is not known"
        raise ConfigError(f"{path}: {key}: {verdict}", "have the file written anew")
    _check(path, entries)
    return Connection(**entries)


def _read_private(path: Path) -> str:
    try:
        with path.open(encoding="utf-8") as stream:
            mode = stat.S_IMODE(os.fstat(stream.fileno()).st_mode)
            text = stream.read()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise ConfigError(
            f"{path}: the connection file cannot be read ({reason})",
            "give the path that the loader or the master wrote",
        ) from error
    if mode & 0o077:
        raise ConfigError(
            f"{path}: holds a secret key, yet others may read it (mode {mode:04o})",
            f"chmod 600 {path}, and make new keys if the machine is shared",
        )
    return text


def _check(path: Path | str, entries: dict[str, object]) -> None:
    for key in KEYS:
        if not is_key(entries[key]):
            raise ConfigError(f"{path}: {key}: not a Z85 CURVE key of 40 characters")
    endpoint, worker = entries["endpoint"], entries["worker"]
    if not isinstance(endpoint, str) or "://" not in endpoint:
        raise ConfigError(f"{path}: endpoint: {endpoint!r} is not tcp://HOST:PORT")
    if not isinstance(worker, str) or not worker or len(worker) > 100 or not worker.isprintable():
        raise ConfigError(f"{path}: worker: {worker!r} is not a name of 1 to 100 characters")
