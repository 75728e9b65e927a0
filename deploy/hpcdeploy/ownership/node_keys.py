"""The CURVE keys of a cluster: made on the user's machine, one pair for the master and each node.

A machine that is replaced gets new ones, and the inventory lists only those of machines that are
there: the keys of a lost machine let nobody in.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path

from hpccomponent.errors import CloudError
from hpccomponent.foreign_json import decode
from hpccomponent.protocol.keys import KeyPair, make_key_pair, write_secret


class NodeKeys:
    """The keys in a file of mode 0600, which need not exist.

    Those of `machine_ids` that lack keys get some now. Raises CloudError where the file is damaged.
    """

    SERVER = "server"
    """The master's name among the machines' ids."""

    def __init__(self, path: Path, machine_ids: Iterable[str]) -> None:
        self._pairs = _read(path)
        missing = {self.SERVER, *machine_ids} - self._pairs.keys()
        if missing:
            self._pairs |= {name: make_key_pair() for name in sorted(missing)}
            self.write(path, self._pairs)

    @classmethod
    def read(cls, path: Path) -> KeyPair | None:
        """Return the master's or None, and make nothing; raise CloudError for a damaged file."""
        return _read(path).get(cls.SERVER)

    @staticmethod
    def write(path: Path, pairs: Mapping[str, KeyPair]) -> None:
        """Keep the keys of the master and of machines, by the machines' ids."""
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_secret(path, json.dumps({name: asdict(pair) for name, pair in pairs.items()}))

    @property
    def server(self) -> KeyPair:
        """The master's."""
        return self._pairs[self.SERVER]

    def of(self, machine_id: str) -> KeyPair:
        """Return those of a machine."""
        return self._pairs[machine_id]


def _read(path: Path) -> dict[str, KeyPair]:
    try:
        return decode(path.read_bytes(), dict[str, KeyPair])
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise CloudError(
            f"{path}: the cluster's keys cannot be read ({error})",
            "delete the file and run hpcapp up again",
        ) from error
