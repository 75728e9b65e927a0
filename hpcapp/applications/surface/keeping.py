"""Finished tiles, kept where a job that was killed finds them again.

A tile's name is a hash of all that it is made of: the input, the settings, the kernels, and which
cells are its own. So nothing that is found can be of another job. The sums of tiles lie beside
them, for the time of one run.

Who may import it: the job and the default method.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any

from hpccomponent.protocol.codec import encode_values
from hpccomponent.store import Store, open_store

__all__ = ["Keeping", "digest"]


def digest(*values: Any) -> str:
    """Return a hash of some values that could travel.

    Examples
    --------
    >>> digest("a", 1) == digest("a", 1) != digest("a", 2)
    True
    """
    header, buffers = encode_values(values)
    found = hashlib.blake2b(header, digest_size=16)
    for buffer in buffers:
        found.update(buffer)
    return found.hexdigest()


@dataclass(frozen=True, slots=True, eq=False)
class Keeping:
    """Where the tiles of a job are kept.

    Parameters
    ----------
    place : str
        See `hpccomponent.store.open_store`.
    job : str
        A hash of the input, the settings and the kernels.
    resumes : bool
        Whether to take what is there already.
    is_shared : bool
        Whether workers see the place: then they put their tiles there themselves, and read points
        from a folder in it.
    """

    place: str
    job: str
    resumes: bool = False
    is_shared: bool = True
    _store: list[Store] = field(default_factory=list)

    @property
    def store(self) -> Store:
        """The store, opened when it is first asked for."""
        if not self._store:
            self._store.append(open_store(self.place))
        return self._store[0]

    def check(self) -> None:
        """Find out whether the place can be had, before the work.

        Raises
        ------
        UsageError, OutputError, CloudError
            See `hpccomponent.store.open_store`.
        """
        self.store.has(f"{self.job}/tile")

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder, not a bucket."""
        return "://" not in self.place

    @property
    def holds_files(self) -> bool:
        """Whether it is a folder that workers see."""
        return self.is_shared and self.is_folder

    def name(self, *values: Any) -> str:
        """Return the name of what is made of some values."""
        return f"{self.job}/{digest(*values)}"

    def name_sums(self, run: str, tile: int) -> str:
        """Return the name of a tile's sums in one run of the job."""
        return f"{self.job}/sums/{run}-{tile}"

    def find(self, name: str) -> Any | None:
        """Return what is kept under a name, None where nothing is or where it is not wanted."""
        return self.store.get(name) if self.resumes and self.store.has(name) else None

    def clear(self) -> None:
        """Take away all that the job has kept."""
        for name in self.store.list(f"{self.job}/"):
            self.store.delete(name)
