"""What machines are called, whose they are, and how many a cluster is to have."""

from __future__ import annotations

import getpass
import os
import re
import secrets
import socket
from datetime import UTC, datetime

from hpccomponent.dataclass import dataclass

MOST_WORKERS = 1000
NAME_PATTERN = r"^[a-z][a-z0-9-]{0,39}$"
"""Of clusters: it becomes part of every name in the cloud."""

HEAD = "head"


@dataclass(frozen=True, slots=True, order=True)
class NodeName:
    """A cluster's machine: ``head``, ``worker-1``, ...; its first replacement is generation 2."""

    node: str
    generation: int = 1


@dataclass(frozen=True, slots=True)
class Owner:
    """Whose a machine is.

    `user` is user and host that made it, or have taken it over; `key` the fingerprint of the public
    key that it lets in, empty where an older release made it.

    Examples
    --------
    >>> str(Owner("anna@lab", "SHA256:abc"))
    'anna@lab SHA256:abc'
    """

    user: str = ""
    key: str = ""

    def __str__(self) -> str:
        """Return the text of the tag."""
        return f"{self.user} {self.key}".strip()


@dataclass(frozen=True, slots=True, order=True)
class Desired:
    """How many workers a cluster is to have, by the last `up` or `scale`: its head bears it.

    `revision` is one more than that of the number before: of two numbers the later one counts,
    however late a cloud lists it.

    Examples
    --------
    >>> str(Desired(7, 3))
    '3, revision 7'
    """

    revision: int
    workers: int

    def __str__(self) -> str:
        """Return the text of the tag."""
        return f"{self.workers}, revision {self.revision}"


NOBODY = Owner()
"""Of what bears no owner."""


def read_owner(text: str) -> Owner:
    """Return whom the text of the tag names; earlier releases wrote no key.

    Examples
    --------
    >>> read_owner("anna@lab SHA256:abc")
    Owner(user='anna@lab', key='SHA256:abc')
    >>> read_owner("anna@lab")
    Owner(user='anna@lab', key='')
    """
    user, _, key = text.strip().partition(" ")
    return Owner(user, key.strip())


def read_desired(text: str) -> Desired | None:
    """Return what the text of the tag says; None where it says nothing that we have written.

    Examples
    --------
    >>> read_desired("3, revision 7")
    Desired(revision=7, workers=3)
    """
    match = re.fullmatch(r"(\d{1,9}), revision (\d{1,9})", text.strip(), re.ASCII)
    if match is None or int(match[1]) > MOST_WORKERS:
        return None
    return Desired(int(match[2]), int(match[1]))


def this_user() -> str:
    """Return user and host of this process, as a tag may hold them."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # an account without a name, as containers have them
        user = f"uid-{os.getuid()}"
    return re.sub(r"[^\w.@-]", "-", f"{user}@{socket.gethostname()}")[:128]


def draw_incarnation(now: datetime) -> str:
    """Draw the name of a new life of a cluster, 12 hexadecimal digits that tell when it began.

    Examples
    --------
    >>> name = draw_incarnation(datetime(2026, 1, 2, tzinfo=UTC))
    >>> len(name), incarnation_began(name).isoformat()
    (12, '2026-01-02T00:00:00+00:00')
    """
    return f"{int(now.timestamp()):08x}{secrets.token_hex(2)}"


def incarnation_began(incarnation: str) -> datetime | None:
    """Return when the life of a cluster began, in UTC; None where its name does not tell."""
    if re.fullmatch(r"[0-9a-f]{12}", incarnation) is None:
        return None
    return datetime.fromtimestamp(int(incarnation[:8], 16), UTC)


def without_node(text: str, node: str) -> str:
    """Return a message without the node that it begins with, for whoever names the node anyway.

    Examples
    --------
    >>> without_node("head (i-1, 10.0.0.7): connection refused", "head")
    'connection refused'
    """
    return re.sub(rf"^{re.escape(node)}( \([^()]*\))?: ", "", text)
