"""The inventory: the file that deploy writes on the head and the HPC App reads.

It tells the App where to listen, with which keys, and which workers it may admit; so the two
need not know one another. Beside it lies a lock: one master at a time holds the cluster.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, field, fields
from pathlib import Path

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ConfigError
from hpccomponent.posix import AS_BYTES, fcntl
from hpccomponent.protocol.keys import check_keys, is_key, read_private_json

INVENTORY_VERSION = 1


@dataclass(frozen=True, slots=True)
class InventoryWorker:
    """A machine with a component: ``head``, ``worker-1``, ...; its CURVE key is in Z85."""

    name: str
    address: str
    public_key: str


@dataclass(frozen=True, slots=True)
class Inventory:
    """A cluster as its HPC App sees it; the keys are the master's, CURVE in Z85.

    `bind` is the ZeroMQ endpoint to listen on: the head's private address, the communicator's port.
    """

    cluster: str
    bind: str
    server_public_key: str
    server_secret_key: str = field(repr=False)
    workers: tuple[InventoryWorker, ...] = ()
    version: int = INVENTORY_VERSION


def dump_inventory(inventory: Inventory) -> str:
    """Return the text of an inventory's file, which must be for its owner only (0600)."""
    return json.dumps(asdict(inventory), indent=2) + "\n"


def read_inventory(path: Path | str) -> Inventory:
    """Read an inventory, and trust it only if nobody else can read it.

    Raise ConfigError, which names the file and the key, where the file is missing or readable by
    group or others, or a key is missing, unknown or not as it should be.
    """
    expected = {item.name for item in fields(Inventory)}
    entries = read_private_json(Path(path), INVENTORY_VERSION, expected)
    for key in ("server_public_key", "server_secret_key"):
        _check_curve_key(f"{path}: {key}", entries[key])
    if not isinstance(entries["cluster"], str) or not entries["cluster"]:
        raise ConfigError(f"{path}: cluster: {entries['cluster']!r} is not a name")
    if not isinstance(entries["bind"], str) or not entries["bind"].startswith("tcp://"):
        raise ConfigError(f"{path}: bind: {entries['bind']!r} is not tcp://HOST:PORT")
    if not isinstance(entries["workers"], list):
        raise ConfigError(f"{path}: workers: not a list")
    workers = tuple(
        _read_worker(f"{path}: workers[{number}]", entry)
        for number, entry in enumerate(entries["workers"])
    )
    return Inventory(**entries | {"workers": workers})


def _read_worker(where: str, entry: object) -> InventoryWorker:
    if not isinstance(entry, dict):
        raise ConfigError(f"{where}: not an object")
    check_keys(where, entry, {item.name for item in fields(InventoryWorker)})
    for key in ("name", "address"):
        if not isinstance(entry[key], str) or not entry[key]:
            raise ConfigError(f"{where}: {key}: {entry[key]!r} is not text")
    _check_curve_key(f"{where}: public_key", entry["public_key"])
    return InventoryWorker(**entry)


def _check_curve_key(where: str, key: object) -> None:
    if not is_key(key):
        raise ConfigError(f"{where}: not a Z85 CURVE key of 40 characters")


@contextmanager
def hold_cluster(path: Path | str, on_wait: Callable[[], None]) -> Iterator[None]:
    """Be the only master of an inventory's cluster; tell `on_wait` and wait while another one is.

    The lock is a file beside the inventory, freed by the system when its holder ends. Raise
    ConfigError where nothing can be written there.
    """
    lock = Path(path).with_suffix(".lock")
    try:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | AS_BYTES, 0o600)
    except OSError as error:
        raise ConfigError(
            f"{lock}: cannot be opened ({error.strerror})", "run as the user who set the cluster up"
        ) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            on_wait()
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
