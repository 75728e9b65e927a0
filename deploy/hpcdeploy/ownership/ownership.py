"""Whose a cluster is: ours where it was made with the key that we hold; pure.

The name of a cluster is all that a cluster file says, and another user's file may say the same.
So everything that is made bears its owner: user, host and the fingerprint of the key that its
machines let in. Only who holds that key may change the cluster; see `termination` for what may
be ended.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator
from datetime import datetime, timedelta

from hpccomponent.dataclass import dataclass
from hpcdeploy.provider import MachineSeen, Observed, State
from hpcdeploy.spec.names import Owner, incarnation_began

MAKING = timedelta(hours=1)
"""What is younger may belong to a cluster that somebody is making right now."""


@dataclass(frozen=True, slots=True)
class Ownership:
    """What this machine holds of a cluster.

    `owner` is us, its key empty where there is none yet; `pairs` are fingerprints of that key in
    the forms of clouds. `lives` are incarnations that our journal has begun: they tell what is ours
    while its tag is not written yet, which not every cloud does in one step.
    """

    owner: Owner
    pairs: frozenset[str] = frozenset()
    lives: frozenset[str] = frozenset()


def fingerprint(public_key: str) -> str:
    """Return the fingerprint of a public key, as ssh-keygen prints it.

    Examples
    --------
    >>> fingerprint("ssh-ed25519 AAAA")
    'SHA256:cJ6AyISHokEeHuTfufIqhhSS0gxHZRUMDHlKvXD4FHw'
    """
    return "SHA256:" + base64.b64encode(_digest(public_key)).decode().rstrip("=")


def cloud_fingerprints(public_key: str) -> frozenset[str]:
    """Return the fingerprints that clouds give of an imported public key; none where it is no key.

    Amazon and Eucalyptus give the MD5 of the DER form of an RSA key; of an Ed25519 key Amazon gives
    what OpenSSH gives.
    """
    from cryptography.hazmat.primitives.serialization import (
        Encoding,
        PublicFormat,
        load_ssh_public_key,
    )

    plain = base64.b64encode(_digest(public_key)).decode()
    try:
        key = load_ssh_public_key(public_key.encode())
    except ValueError:
        return frozenset()
    der = key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    short = hashlib.md5(der, usedforsecurity=False).hexdigest()
    pairs = ":".join(short[i : i + 2] for i in range(0, len(short), 2))
    return frozenset({pairs, plain, plain.rstrip("=")})


def _digest(public_key: str) -> bytes:
    return hashlib.sha256(base64.b64decode(public_key.split()[1])).digest()


def ours(observed: Observed, ownership: Ownership) -> frozenset[str]:
    """Return the ids of the machines that are ours."""
    return frozenset(m.id for m in observed.machines if _is_ours(m, observed, ownership))


def foreign_owner(observed: Observed, ownership: Ownership, now: datetime) -> Owner | None:
    """Return whose a cluster is where not all of it is ours; None where we may change it."""
    return next(_foreign(observed, ownership, now), None)


def _foreign(observed: Observed, ownership: Ownership, now: datetime) -> Iterator[Owner]:
    # What is ending is let go by its owner; a host that hides what it does hides its owner too.
    hidden = (State.ENDING, State.GONE, State.UNKNOWN)
    machines = [m for m in observed.machines if m.state not in hidden]
    for machine in machines:
        if not _is_ours(machine, observed, ownership):
            yield _owner_of(machine, observed)
    occupied = {machine.incarnation for machine in machines}
    for life in observed.lives:
        if life.owner.key:
            if life.owner.key != ownership.owner.key:
                yield life.owner
        elif life.incarnation not in occupied:  # else its machines have told
            began = incarnation_began(life.incarnation)
            is_young = began is not None and began + MAKING > now
            if is_young and not _is_begun_by_us(life.incarnation, observed, ownership):
                yield life.owner


def _is_ours(machine: MachineSeen, observed: Observed, ownership: Ownership) -> bool:
    key = _owner_of(machine, observed).key
    if key:
        return key == ownership.owner.key
    return _is_begun_by_us(machine.incarnation, observed, ownership)


def _owner_of(machine: MachineSeen, observed: Observed) -> Owner:
    """Return whose a machine is; while it bears no key, whose its life is."""
    if machine.owner.key:
        return machine.owner
    of_life = (r.owner for r in observed.lives if r.incarnation == machine.incarnation)
    return next((owner for owner in of_life if owner.key), machine.owner)


def _is_begun_by_us(incarnation: str, observed: Observed, ownership: Ownership) -> bool:
    """Tell whether a life without an owner is ours: by our journal, or by its key."""
    prints = {r.fingerprint for r in observed.resources if r.incarnation == incarnation} - {""}
    return incarnation in ownership.lives or bool(prints & ownership.pairs)
