"""The inventory: the file that deploy writes on the head and the HPC App reads.

It tells the App where to listen, with which keys, and which workers it may admit; so the two
need not know one another.
"""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["Inventory", "InventoryWorker"]


@dataclass(frozen=True, slots=True)
class InventoryWorker:
    """A machine with a component.

    Parameters
    ----------
    name : str
        ``head``, ``worker-1``, ...
    address : str
        Its private one.
    public_key : str
        CURVE, Z85.
    """

    name: str
    address: str
    public_key: str


@dataclass(frozen=True, slots=True)
class Inventory:
    """A cluster as its HPC App sees it.

    Parameters
    ----------
    cluster : str
    bind : str
        ZeroMQ endpoint to listen on: the head's private address and the communicator's port.
    server_public_key, server_secret_key : str
        The master's CURVE keys, Z85.
    workers : tuple of InventoryWorker
    version : int
        Of the file's format.
    """

    cluster: str
    bind: str
    server_public_key: str
    server_secret_key: str = field(repr=False)
    workers: tuple[InventoryWorker, ...] = ()
    version: int = 1
