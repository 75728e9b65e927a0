"""What resources are called: everything is derived from cluster, node and generation.

So a second `up` asks the cloud for the very resources that the first one asked for, and a sweep
finds them by the cloud's own lists, with no memory of ours.
"""

from __future__ import annotations

import getpass
import hashlib
import os
import re
import secrets
import socket
from dataclasses import dataclass
from datetime import UTC, datetime

__all__ = [
    "CLUSTER_TAG",
    "GENERATION_TAG",
    "HEAD",
    "INCARNATION_TAG",
    "LEASE_TAG",
    "MADE_TAG",
    "MOST_WORKERS",
    "NAME_PATTERN",
    "NOBODY",
    "NODE_TAG",
    "OWNER_TAG",
    "PREFIX",
    "WORKERS_TAG",
    "Desired",
    "NodeName",
    "Owner",
    "client_token",
    "draw_incarnation",
    "group_name",
    "incarnation_began",
    "key_pair_name",
    "read_client_token",
    "read_desired",
    "read_owner",
    "this_user",
    "without_node",
]

PREFIX = "hpcapp-"
MOST_WORKERS = 1000
NAME_PATTERN = r"^[a-z][a-z0-9-]{0,39}$"
"""Of clusters: it becomes part of every name in the cloud."""

HEAD = "head"
CLUSTER_TAG = "hpcapp:cluster"
NODE_TAG = "hpcapp:node"
GENERATION_TAG = "hpcapp:generation"
INCARNATION_TAG = "hpcapp:incarnation"
LEASE_TAG = "hpcapp:lease-until"
OWNER_TAG = "hpcapp:owner"
WORKERS_TAG = "hpcapp:workers"
MADE_TAG = "hpcapp:made-as"


@dataclass(frozen=True, slots=True, order=True)
class NodeName:
    """Which machine of a cluster, and the how-manieth of that name.

    Parameters
    ----------
    node : str
        ``head`` or ``worker-1``, ``worker-2``, ...
    generation : int
        From 1; a replacement has the next one.
    """

    node: str
    generation: int = 1


@dataclass(frozen=True, slots=True)
class Owner:
    """Whose a machine is.

    Parameters
    ----------
    user : str
        User and host that made it, or have taken it over.
    key : str
        Fingerprint of the public key that it lets in; empty where an older release made it.

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

    Parameters
    ----------
    revision : int
        One more than that of the number before: of two numbers the later one counts, however late
        a cloud lists it.

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


def group_name(cluster: str) -> str:
    """Return the name of the security group of a cluster."""
    return PREFIX + cluster


def key_pair_name(cluster: str, incarnation: str) -> str:
    """Return the name of the key pair of one life of a cluster.

    Not every cloud can tag a key pair: what tells ours from a user's own is that it is named
    after the life that the description of a group of ours remembers.
    """
    return f"{PREFIX}{cluster}-{incarnation}"


def draw_incarnation(now: datetime) -> str:
    """Draw the name of a new life of a cluster; it tells when that life began.

    Parameters
    ----------
    now : datetime
        With its time zone.

    Returns
    -------
    str
        12 hexadecimal digits.

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


def client_token(cluster: str, incarnation: str, name: NodeName, attempt: str = "") -> str:
    """Return the token by which the cloud recognises a repeated request to launch a node.

    Parameters
    ----------
    incarnation : str
        Drawn once for each life of the cluster, from the first `up` to `down`: a cloud remembers
        a token after its machine is gone (see `GroupSeen`). Small letters and digits.
    attempt : str
        What is asked for when an earlier choice was not to be had: instance type and market.

    Returns
    -------
    str
        At most 64 characters; `read_client_token` reads it. A long cluster's name is cut, which
        leaves the token unique by its incarnation.

    Examples
    --------
    >>> client_token("bunny", "a1b2c3", NodeName("worker-2"))
    'hpcapp-bunny-a1b2c3-worker-2-1'
    """
    digest = f"-{hashlib.sha256(attempt.encode()).hexdigest()[:8]}" if attempt else ""
    tail = f"-{incarnation}-{name.node}-{name.generation}{digest}"
    return group_name(cluster)[: 64 - len(tail)] + tail


_TOKEN = re.compile(rf"{PREFIX}.+-([0-9a-z]+)-({HEAD}|worker-\d+)-(\d+)(?:-[0-9a-f]{{8}})?")


def read_client_token(token: str) -> tuple[str, NodeName] | None:
    """Return the incarnation and the node that a token is of; None where it is none of ours.

    So a machine is known whose tags were never written.

    Examples
    --------
    >>> read_client_token("hpcapp-bunny-a1b2c3-worker-2-1")
    ('a1b2c3', NodeName(node='worker-2', generation=1))
    """
    match = _TOKEN.fullmatch(token)
    return (match[1], NodeName(match[2], int(match[3]))) if match else None


def without_node(text: str, node: str) -> str:
    """Return a message without the node that it begins with, for whoever names the node anyway.

    Examples
    --------
    >>> without_node("head (i-1, 10.0.0.7): connection refused", "head")
    'connection refused'
    """
    return re.sub(rf"^{re.escape(node)}( \([^()]*\))?: ", "", text)
