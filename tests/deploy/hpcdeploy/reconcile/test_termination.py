"""What may be ended, and by which proof: the table of the design page, row by row."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from simulated import START
from simulated.memory import MemoryProvider

import hpcdeploy
from hpccomponent.errors import CloudError
from hpcdeploy.ownership.ownership import Ownership, foreign_owner, ours
from hpcdeploy.provider import MachineSeen, Observed, State
from hpcdeploy.providers.ec2.observe import GroupSeen, KeyPairSeen
from hpcdeploy.reconcile.termination import Proof, Reason, end, may_terminate
from hpcdeploy.spec.names import NodeName, Owner, draw_incarnation

ANNA, BEN = Owner("anna@lab", "SHA256:anna"), Owner("ben@lab", "SHA256:ben")
RUNS = MachineSeen(
    "i-1", "bunny", NodeName("head"), "life", State.RUNNING,
    launched=START - timedelta(days=2), lease_until=START + timedelta(hours=1), owner=ANNA,
)  # fmt: skip
OURS = Proof(ours=frozenset({"i-1"}), now=START)


@pytest.mark.parametrize("reason", Reason)
@pytest.mark.parametrize("state", [State.PENDING, State.RUNNING, State.UNKNOWN])
def test_without_a_proof_nothing_that_may_be_at_work_is_ended(reason: Reason, state: State) -> None:
    everything = Proof(unused=frozenset({"i-1"}), launched=frozenset({"i-1"}), now=START)
    assert not may_terminate(replace(RUNS, state=state), reason, everything)


@pytest.mark.parametrize(
    ("reason", "proof"),
    [
        (Reason.UNUSABLE, replace(OURS, unused=frozenset({"i-1"}))),
        (Reason.EARLIER_LIFE, OURS),
        (Reason.UNWANTED, OURS),
        (Reason.DUPLICATE, OURS),
        (Reason.ROLL_BACK, replace(OURS, launched=frozenset({"i-1"}))),
        (Reason.DOWN, OURS),
        (Reason.DOWN, Proof(lives=frozenset({"life"}))),
        (Reason.OVERDUE, Proof(now=START + timedelta(hours=2))),
    ],
)
def test_each_reason_has_its_proof(reason: Reason, proof: Proof) -> None:
    assert may_terminate(RUNS, reason, proof)


@pytest.mark.parametrize("reason", [Reason.UNUSABLE, Reason.ROLL_BACK, Reason.SHUT_DOWN])
def test_that_a_machine_is_ours_is_no_proof_that_it_is_of_no_use(reason: Reason) -> None:
    assert not may_terminate(RUNS, reason, OURS)


def test_nothing_is_ended_where_one_of_the_machines_may_not_be() -> None:
    called: list[str] = []
    cloud = MemoryProvider(hook=lambda moment, call: called.append(call))
    with pytest.raises(CloudError, match=r"head \(i-2\) stays"):
        end(cloud, [RUNS, replace(RUNS, id="i-2")], Reason.UNWANTED, OURS)
    assert called == []


def test_no_module_ends_machines_past_the_one_that_asks_for_a_proof() -> None:
    folder = Path(hpcdeploy.__file__).parent
    found = [
        path.name
        for path in folder.rglob("*.py")
        if re.search(r"provider\.terminate\(", path.read_text(encoding="utf-8"))
    ]
    assert found == ["termination.py"]


LIFE = draw_incarnation(START - timedelta(days=1))
YOUNG = draw_incarnation(START - timedelta(minutes=1))
GROUP = GroupSeen("bunny", "hpcapp-bunny", LIFE, "sg")
PAIR = KeyPairSeen("bunny", "n", "life", fingerprint="aa:bb")


@pytest.mark.parametrize(
    ("observed", "ownership", "whose"),
    [
        (Observed(), Ownership(Owner("ben@lab")), None),
        (Observed((RUNS,)), Ownership(BEN), ANNA),
        (Observed((RUNS,)), Ownership(Owner("ben@lab")), ANNA),
        (Observed((RUNS,)), Ownership(Owner("ben@lab", ANNA.key)), None),  # the key handed over
        (Observed((replace(RUNS, state=State.GONE),)), Ownership(BEN), None),
        (Observed((replace(RUNS, state=State.UNKNOWN, owner=Owner()),)), Ownership(BEN), None),
        # a life without an owner's key: by its group, by our journal, by its key pair
        (Observed((replace(RUNS, owner=Owner("anna@lab")),)), Ownership(BEN), Owner("anna@lab")),
        (
            Observed(
                (replace(RUNS, incarnation=LIFE, owner=Owner()),), (replace(GROUP, owner=ANNA),)
            ),
            Ownership(ANNA),
            None,
        ),
        (
            Observed((replace(RUNS, owner=Owner()),)),
            Ownership(BEN, lives=frozenset({"life"})),
            None,
        ),
        (
            Observed((replace(RUNS, owner=Owner()),), (PAIR,)),
            Ownership(BEN, frozenset({"aa:bb"})),
            None,
        ),
        # a group alone
        (Observed((), (replace(GROUP, owner=ANNA),)), Ownership(BEN), ANNA),
        (Observed((), (GROUP,)), Ownership(BEN), None),  # left, and nobody's machine is in it
        (Observed((), (replace(GROUP, incarnation=YOUNG),)), Ownership(BEN), Owner()),
        (
            Observed((), (replace(GROUP, incarnation=YOUNG),)),
            Ownership(BEN, lives=frozenset({YOUNG})),
            None,
        ),
    ],
)
def test_whose_a_cluster_is(observed: Observed, ownership: Ownership, whose: Owner | None) -> None:
    assert foreign_owner(observed, ownership, START) == whose
    if whose is not None and observed.machines:
        assert ours(observed, ownership) == frozenset()
