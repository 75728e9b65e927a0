"""The journal: what `up` and `down` were about to do, written before they do it.

It tells the user what was under way when a command was cut short or failed, and lets the next one
ask the cloud again with the very same token. It also remembers which machines are set up or of no
use, and where something was made. What exists is found by the cloud's own lists alone, see
`provider.Provider.observe`. One line of JSON for each intent and each outcome, synced to the disk;
the last line may be torn. While a journal is open no other command changes the cluster from this
machine.
"""

from __future__ import annotations

import fcntl
import io
import json
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import IO, Annotated, TypedDict, cast

from msgspec import Meta

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CapacityError, CloudError, OutputError
from hpccomponent.foreign_json import convert, decode
from hpcdeploy.provider import LaunchChoice
from hpcdeploy.spec.layout import state_folder
from hpcdeploy.spec.names import NodeName
from hpcdeploy.spec.polling import utc_now

Launched = tuple[str, NodeName]
"""The incarnation and the node of a machine that was asked for."""

Step = Callable[[str], AbstractContextManager[object]]
"""Writes an intent, lets it be carried out, writes how it went; see `Journal.step`."""


MOST_WHY = 1000
"""Characters of a reason: a machine may say anything, and nobody reads more."""
Text = Annotated[str, Meta(max_length=1 << 16)]
Entry = TypedDict(
    "Entry",
    {
        "intent": Text,
        "done": Text,
        "refused": Text,
        "failed": Text,
        "why": str,
        "is_command": bool,
        "bad": Text,
        "set up": list[Text],
        "setting up": list[Text],
        "place": Text,
        "cleared": Text,
        "incarnation": Text,
        "node": Text,
        "generation": Annotated[int, Meta(ge=1, le=1 << 30)],
        "key": Text,
        "instance_type": Text,
        "market": Text,
        "zone": Text,
        "lease_until": Text,
    },
    total=False,
)
"""A line of the journal: what is read of it."""


@dataclass(frozen=True, slots=True)
class _Launch:
    """What an entry says of a launch; an older release wrote no zone."""

    instance_type: Text
    market: Text
    lease_until: Annotated[datetime, Meta(tz=True)]
    zone: Text = ""


@dataclass(frozen=True, slots=True)
class Attempt:
    """A launch that has come about, or may have: a cloud lists a new machine with a delay.

    A repeated request must be the same in all its parts, hence `lease_until`.
    """

    choice: LaunchChoice
    lease_until: datetime


class Journal:
    """A journal that is open or was read; see `open_journal` and `peek_journal`."""

    def __init__(self, file: IO[bytes], entries: list[Entry]) -> None:
        self._file = file
        self._entries = entries
        self._opened = len(entries)
        self._lock = threading.Lock()

    def command(self, what: str) -> AbstractContextManager[None]:
        """Write a whole command's intent, let it be carried out, write how it went.

        Once it is done, nothing that was begun before it is unfinished any more.
        """
        return self.step(what, is_command=True)

    @contextmanager
    def step(self, what: str, **details: str | int) -> Iterator[None]:
        """Write an intent, let it be carried out, write how it went.

        The user may read `what`; `details` are what the next command needs to know about it.
        """
        about = cast(Entry, details)
        self._write({"intent": what, **about})
        try:
            yield
        except CapacityError as error:
            self._write({"refused": what, "why": str(error)[:MOST_WHY], **about})
            raise
        except Exception as error:
            self._write({"failed": what, "why": str(error)[:MOST_WHY], **about})
            raise
        self._write({"done": what, **about})

    def note_bad(self, machine_id: str, reason: str) -> None:
        """Remember a machine as useless, with a line of why: the next `up` replaces it at once."""
        self._write({"bad": machine_id, "why": reason[:MOST_WHY]})

    @property
    def known_bad(self) -> frozenset[str]:
        """The ids of machines that are of no use."""
        return frozenset(entry["bad"] for entry in self._entries if "bad" in entry)

    def note_set_up(self, machine_ids: Iterable[str], *, is_done: bool) -> None:
        """Remember that the set-up of machines begins or, with `is_done`, that they are set up."""
        known = self.set_up if is_done else self._setting_up
        if new := sorted(set(machine_ids) - known):
            self._write({"set up": new} if is_done else {"setting up": new})

    @property
    def used(self) -> frozenset[str]:
        """The ids of machines that are set up, or may be: whoever set them up told no end."""
        return self.set_up | (self._setting_up - self.known_bad)

    @property
    def _setting_up(self) -> frozenset[str]:
        return frozenset(i for entry in self._entries for i in entry.get("setting up", ()))

    @property
    def set_up(self) -> frozenset[str]:
        """The ids of machines that were set up from here."""
        return frozenset(i for entry in self._entries for i in entry.get("set up", ()))

    def launched(self, *, since_opened: bool = False) -> frozenset[Launched]:
        """Return incarnation and name of the machines that were asked for, answered or not.

        Those of earlier releases, which did not write down what is set up, do not count; with
        `since_opened`, only those do that were asked for since the journal was opened.
        """
        return frozenset(
            (entry["incarnation"], NodeName(entry["node"], entry["generation"]))
            for entry in self._entries[self._opened if since_opened else 0 :]
            if {"intent", "key", "incarnation", "node", "generation"} <= entry.keys()
        )

    @property
    def lives(self) -> frozenset[str]:
        """The incarnations of the cluster that were begun or used from here."""
        return frozenset(entry["incarnation"] for entry in self._entries if "incarnation" in entry)

    def note_places(self, places: Iterable[str]) -> None:
        """Remember where something is about to be made."""
        known = self.places
        for place in (place for place in places if place not in known):
            self._write({"place": place})

    def clear_places(self, places: Iterable[str]) -> None:
        """Remember that nothing is left in some places."""
        for place in set(self.places).intersection(places):
            self._write({"cleared": place})

    @property
    def places(self) -> tuple[str, ...]:
        """Where something was made that was not taken down since, the earliest first."""
        places: dict[str, None] = {}
        for entry in self._entries:
            match entry:
                case {"place": place}:
                    places[place] = None
                case {"cleared": place}:
                    places.pop(place, None)
        return tuple(places)

    def unfinished(self) -> list[str]:
        """Return what was begun and neither done nor refused, in the order in which it was begun.

        What has failed is among it: the call may have come about and its answer been lost, and
        what a command made before it failed may not be listed yet.
        """
        pending: list[str] = []
        for entry in self._entries:
            match entry:
                case {"intent": what}:
                    pending = [*(other for other in pending if other != what), what]
                case {"done": what, "is_command": True} if what in pending:
                    pending = pending[pending.index(what) + 1 :]
                case {"done": what} | {"refused": what}:
                    pending = [other for other in pending if other != what]
        return pending

    def attempt(self, incarnation: str, name: NodeName) -> Attempt | None:
        """Return the launch of a node that was asked for last, unless it was refused."""
        of_node = {"incarnation": incarnation, "node": name.node, "generation": name.generation}
        for entry in reversed(self._entries):
            if of_node.items() <= entry.items():
                if "refused" in entry:
                    return None
                with suppress(ValueError):  # not of a launch
                    launch = convert(entry, _Launch)
                    choice = LaunchChoice(launch.instance_type, launch.market, launch.zone)
                    return Attempt(choice, launch.lease_until)
        return None

    def _write(self, entry: Entry) -> None:
        line = json.dumps({"at": utc_now().isoformat(timespec="milliseconds"), **entry})
        with self._lock:
            self._entries.append(entry)
            self._file.write(line.encode() + b"\n")
            os.fsync(self._file.fileno())


@contextmanager
def open_journal(cluster: str) -> Iterator[Journal]:
    """Open the journal of a cluster, for this process alone.

    Raises CloudError where another process has it open, OutputError where its folder cannot be
    written.
    """
    path = state_folder(cluster) / "journal.jsonl"
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        file = path.open("ab+", buffering=0)
    except OSError as error:
        raise OutputError(
            f"{path}: {error.strerror}", "set XDG_STATE_HOME to a folder that can be written"
        ) from None
    with file:
        if not _is_ours(file):
            raise CloudError(
                f"cluster {cluster} is being changed by another hpcapp on this machine",
                "wait for it to end, or end it",
            )
        yield Journal(file, _read(file, path))


def peek_journal(cluster: str) -> Journal:
    """Return what the journal of a cluster says now, for who only reads; takes no lock.

    Nothing can be written to it. A line that another command has half written is left out.
    """
    try:
        lines = (state_folder(cluster) / "journal.jsonl").read_bytes().splitlines()
    except OSError:
        lines = []
    entries = []
    for line in lines:
        with suppress(ValueError):
            entries.append(decode(line, Entry))
    return Journal(io.BytesIO(), entries)


def _is_ours(file: IO[bytes]) -> bool:
    """Lock the journal; tell whether it was free, and not removed by a `down` meanwhile."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return os.fstat(file.fileno()).st_nlink > 0


def _read(file: IO[bytes], path: Path) -> list[Entry]:
    """Read all entries, and cut off a last line that is torn."""
    file.seek(0)
    text = file.read()
    whole = text[: text.rfind(b"\n") + 1]
    if len(whole) < len(text):
        file.truncate(len(whole))
    entries = []
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            entries.append(decode(line, Entry))
        except ValueError:
            raise CloudError(
                f"{path}:{number}: not a line of the journal",
                "move the file away: machines are found by the cloud's own lists, but which of "
                "them were never set up and what an earlier file made is not known then",
            ) from None
    return entries
