"""What resources are called: everything is derived from cluster, node and generation.

So a second `up` asks the cloud for the very resources that the first one asked for, and a sweep
finds them by the cloud's own lists, with no memory of ours.
"""

from __future__ import annotations

import hashlib
import re

from hpcdeploy.spec.names import HEAD, NodeName

PREFIX = "hpcapp-"
CLUSTER_TAG = "hpcapp:cluster"
NODE_TAG = "hpcapp:node"
GENERATION_TAG = "hpcapp:generation"
INCARNATION_TAG = "hpcapp:incarnation"
LEASE_TAG = "hpcapp:lease-until"
OWNER_TAG = "hpcapp:owner"
WORKERS_TAG = "hpcapp:workers"
MADE_TAG = "hpcapp:made-as"
SET_UP_TAG = "hpcapp:set-up-by"


def group_name(cluster: str) -> str:
    """Return the name of the security group of a cluster."""
    return PREFIX + cluster


def key_pair_name(cluster: str, incarnation: str) -> str:
    """Return the name of the key pair of one life of a cluster.

    Not every cloud can tag a key pair: what tells ours from a user's own is that it is named
    after the life that the description of a group of ours remembers.
    """
    return f"{PREFIX}{cluster}-{incarnation}"


def client_token(cluster: str, incarnation: str, name: NodeName, attempt: str = "") -> str:
    """Return the token by which the cloud recognises a repeated request to launch a node.

    `incarnation`, small letters and digits, is drawn once for each life of the cluster, from the
    first `up` to `down`: a cloud remembers a token after its machine is gone (see `GroupSeen`).
    `attempt` is what is asked for when an earlier choice was not to be had: instance type and
    market.

    It has at most 64 characters: a long cluster's name is cut, which leaves the token unique by its
    incarnation. `read_client_token` reads it.

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
