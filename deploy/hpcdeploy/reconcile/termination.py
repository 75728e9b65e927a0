"""What may be ended, and by which proof: every termination passes `end`.

A machine that runs may be at work for somebody, whatever we can see of it. That we cannot log in
to it, cannot set it up again or do not find our names on it proves nothing.
`docs/explanation/design.md` has the table of what each path may end.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from enum import StrEnum

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError
from hpcdeploy.ownership.ownership import MAKING
from hpcdeploy.provider import MachineSeen, Provider, State

CLOCK_GRACE = timedelta(minutes=5)
"""Clocks differ: a lease is over so long after its end."""


class Reason(StrEnum):
    """Why a machine is to end."""

    UNUSABLE = "it could not be set up"
    SHUT_DOWN = "it has shut down"
    EARLIER_LIFE = "left from an earlier life of the cluster"
    UNWANTED = "the file wants fewer machines"
    DUPLICATE = "another machine has its name"
    ROLL_BACK = "what was made is taken away again"
    DOWN = "the cluster is taken down"
    OVERDUE = "its lease is over"


@dataclass(frozen=True, slots=True)
class Proof:
    """What a command can show for itself.

    Parameters
    ----------
    ours : frozenset of str
        Ids of machines that bear our key, see `ownership.ours`.
    unused : frozenset of str
        Ids of machines that our journal has launched in this life and that nobody has set up.
    launched : frozenset of str
        Ids of machines that this very command has launched, and that nobody else sets up.
    lives : frozenset of str
        Incarnations that were there when the user asked for the whole cluster to go: ours, or
        another's whose name the user has typed.
    """

    ours: frozenset[str] = frozenset()
    unused: frozenset[str] = frozenset()
    launched: frozenset[str] = frozenset()
    lives: frozenset[str] = frozenset()
    now: datetime | None = None


def may_terminate(machine: MachineSeen, reason: Reason, proof: Proof) -> bool:
    """Tell whether a machine may be ended for a reason; pure."""
    is_ours = machine.id in proof.ours
    match reason:
        case Reason.UNUSABLE:
            return is_ours and machine.id in proof.unused
        case Reason.SHUT_DOWN:
            return is_ours and machine.state is State.STOPPED
        case Reason.EARLIER_LIFE | Reason.UNWANTED | Reason.DUPLICATE:
            return is_ours and machine.state is not State.UNKNOWN
        case Reason.ROLL_BACK:
            return is_ours and machine.id in proof.launched
        case Reason.DOWN:
            return is_ours or machine.incarnation in proof.lives
        case Reason.OVERDUE:
            return proof.now is not None and is_overdue(machine, proof.now)


def is_overdue(machine: MachineSeen, now: datetime) -> bool:
    """Tell whether a machine's own lease, or its own end, proves that nobody uses it.

    Without a lease in sight it runs on: the guard on it knows its lease, and shuts it down.
    """
    if machine.state is State.STOPPED:
        is_old = machine.launched is not None and machine.launched + MAKING < now
        return machine.lease_until is not None or is_old
    return machine.lease_until is not None and machine.lease_until + CLOCK_GRACE < now


def end(provider: Provider, machines: Sequence[MachineSeen], reason: Reason, proof: Proof) -> None:
    """Begin to end machines; nothing is ended where one of them may not be.

    Raises CloudError where the proof does not suffice, or the cloud refuses.
    """
    for machine in machines:
        if not may_terminate(machine, reason, proof):
            raise CloudError(
                f"{machine.name.node} ({machine.id}) stays: that {reason} is no proof that it "
                "may be ended",
                "end it in the cloud's console, or take the cluster down",
            )
    provider.terminate(machines)
