"""Finished tiles, kept where a job that was killed, or one of more scans, finds them again.

A tile's name is a hash of all that it is made of: the settings, the kernels, which cells are its
own, and its points, or the whole input, in whose folder it lies then. So nothing that is found can
be of another job. The sums of tiles lie beside them, for the time of one run.
"""

from __future__ import annotations

import hashlib
import logging
import os
from dataclasses import field
from pathlib import Path
from typing import Any

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError, ProtocolError
from hpccomponent.files.private_files import make_private_folder
from hpccomponent.protocol.codec import encode_values
from hpccomponent.protocol.declared import Declared, check_result
from hpccomponent.store.base import Store
from hpccomponent.store.places import open_store

log = logging.getLogger("hpcapp")

SUMS = "sums"
"""The folder of what is of one run."""

FRAMES = "frames"
"""The folder of what the tiles of a mesh have in common, beside that of the tiles."""

POINTS_NOTE = ["points", "loaded"]
"""Where it says that all points are there."""


def digest(*values: Any) -> str:
    """Return a hash of some values that could travel (see `encode_values`), 32 hexadecimal digits.

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
class Checkpoint:
    """Where the tiles of a job are kept: see `hpccomponent.store.places.open_store`.

    The `job` is a hash of the input, the settings and the kernels, and a name of the run: the
    folder of the job, or the prefix of its names. What is there already is taken if it `resumes`.
    Where the place `is_shared`, workers see it: then they put their tiles there themselves, and
    read points from a folder in it.

    With a `recipe`, a hash of the settings and the kernels alone, tiles are named by their points
    as well, and lie there for jobs of other input.
    """

    place: str
    job: str
    resumes: bool = False
    is_shared: bool = True
    recipe: str = ""
    _store: list[Store] = field(default_factory=list)
    _names: set[str] = field(default_factory=set)

    @property
    def store(self) -> Store:
        """The store, opened when it is first asked for."""
        if not self._store:
            self._store.append(open_store(self.place))
        return self._store[0]

    def check(self) -> None:
        """Find out whether the place can be had, before the work; raise as `open_store` does."""
        self.store.has(f"{self.job}/tile")

    def make_folders(self) -> None:
        """Make the folders that tasks put their values into; they make none."""
        make_private_folder(Path(self.place, self.job, SUMS))

    @property
    def where(self) -> str:
        """What messages call the place."""
        return f"{self.place}/{self.job}"

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder, not a bucket."""
        return "://" not in self.place

    @property
    def holds_files(self) -> bool:
        """Whether it is a folder that workers see."""
        return self.is_shared and self.is_folder

    def name(self, *values: Any) -> str:
        """Return the name of what is made of some values (see `digest`)."""
        name = f"{self.job}/{digest(self.recipe, *values)}"
        self._names.add(name)
        return name

    def name_beside(self, name: str, what: str) -> str:
        """Return the name of what is made of something that has a name."""
        beside = f"{name}-{what}"
        self._names.add(beside)
        return beside

    def name_frame(self, what: str) -> str:
        """Return the name of something that all tiles of the recipe have in common."""
        return f"{FRAMES}/{self.recipe}-{what}"

    def name_sums(self, run: str, tile: int) -> str:
        """Return the name of a tile's sums; `run` differs from that of any other run of the job."""
        return f"{self.job}/{SUMS}/{run}-{tile}"

    def get(self, name: str, declared: Declared) -> Any:
        """Return what a worker has kept under a name, which must be as declared.

        Raise JobError where it is not there, or damaged, or something else.
        """
        kept = self.store.get(name)
        try:
            check_result(declared, kept)
        except ProtocolError as error:
            raise JobError(
                f"{self.place}/{name}: what is kept there is wrong: {error.problem}",
                "run the job again; it is a worker that has put it there",
            ) from error
        return kept

    def find(self, name: str, declared: Declared) -> Any | None:
        """Return what is kept under a name, None where nothing is or where it is not wanted.

        What is damaged or not as declared is taken away, and named: whoever asked makes it again.
        """
        if not self.resumes:
            return None
        try:
            if self.store.has(name):
                return self.get(name, declared)
            if not (self.is_folder and os.path.lexists(Path(self.place, name))):
                return None
            problem = f"{Path(self.place, name)} is not a file"
        except JobError as error:
            problem = error.problem
        log.warning("warning: %s: this tile is made again", problem)
        self.store.delete(name)
        return None

    def find_frame(self, what: str) -> Any | None:
        """Return what all tiles of the recipe have in common, None where nothing is, or damaged."""
        name = self.name_frame(what)
        try:
            return self.store.get(name) if self.store.has(name) else None
        except JobError as error:
            log.warning("warning: %s: all tiles are made again", error.problem)
            self.store.delete(name)
            return None

    def begin_frame(self, frame: Any) -> None:
        """Keep what all tiles of the recipe have in common from now on."""
        for name in self.store.list(f"{FRAMES}/"):
            self.store.delete(name)
        self.store.put(self.name_frame("cloud"), frame)

    def clear_others(self) -> None:
        """Take away what this job has not named: other tiles, what was cut of tiles, and sums."""
        for name in self.store.list(f"{self.job}/"):
            if name not in self._names:
                self.store.delete(name)

    def holds_work(self) -> bool:
        """Tell whether another run could go on from what is kept: a tile, or all points."""
        names = (name.split("/")[1:] for name in self.store.list(f"{self.job}/"))
        return any(len(name) == 1 or name == POINTS_NOTE for name in names)

    def clear(self) -> None:
        """Take away all that the job has kept, and what its tiles have in common."""
        for folder in (self.job, FRAMES) if self.recipe else (self.job,):
            for name in self.store.list(f"{folder}/"):
                self.store.delete(name)
