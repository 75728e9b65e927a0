"""Taking things away, and proving that they are gone: for `down`, `reap` and a failed `up`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from hpccomponent.errors import CloudError, LeftoverError
from hpcdeploy.ownership.journal import Step
from hpcdeploy.provider import MachineSeen, Observed, Provider, State
from hpcdeploy.reconcile.termination import Proof, Reason, end
from hpcdeploy.spec.layout import machine_folder
from hpcdeploy.spec.polling import Polling

TRIES = 3
"""Refusals in a row after which a removal is given up."""


def remove(
    provider: Provider,
    doomed: Callable[[], tuple[Observed, Proof]],
    reason: Reason,
    step: Step,
    report: Callable[[str], None],
    polling: Polling,
    quiet_looks: int = 1,
) -> None:
    """Take away what must go until the cloud lists none of it any more.

    `doomed` looks at the cloud; returns what must go, and by which proof. Nothing must be found
    `quiet_looks` times in a row: more than once where a machine may just have been asked for, which
    clouds list with a delay. Raises LeftoverError, with what is left and why.
    """
    quiet, refusals, trouble = 0, 0, ""
    remains = Observed()
    told: set[str] = set()

    def tell(line: str) -> None:
        if line not in told:
            told.add(line)
            report(line)

    for look, _ in enumerate(polling.looks(polling.end_s)):
        remains, proof = doomed()
        remains = _present(remains)
        if look and _is_any(remains) and not _is_hidden(remains):  # those are not waited for
            tell(f"waiting until {describe(remains)} is gone, {polling.end_s:.0f} s at most")
        terminate = partial(end, provider, reason=reason, proof=proof)
        quiet = 0 if _is_any(remains) else quiet + 1
        if quiet >= quiet_looks:
            return
        try:
            _take_away(provider, remains, terminate, step, tell)
            refusals = refusals + 1 if _is_hidden(remains) else 0
        except CloudError as error:
            refusals, trouble = refusals + 1, str(error)
        if refusals >= TRIES:
            break
    raise _leftover(provider, remains, trouble)


def _leftover(provider: Provider, remains: Observed, trouble: str) -> LeftoverError:
    """Say what is left, or may be, and what to do about it."""
    why = f" ({trouble})" if trouble else ""
    what = describe(remains) or "perhaps a machine that the cloud does not list yet"
    if provider.makes_machines:
        return LeftoverError(
            f"still there: {what}{why}",
            "it may cost money: run the command again, or remove it in the cloud's console",
        )
    if not _is_hidden(remains):
        return LeftoverError(f"still there: {what}{why}", "run the command again")
    folders = {f"~/{machine_folder(machine.cluster)}" for machine in remains.machines}
    return LeftoverError(
        f"not known whether anything is left on {what}{why}",
        f"run the command again when they answer, or remove {', '.join(sorted(folders))} there",
    )


def describe(observed: Observed) -> str:
    """Name all that was observed, in one line; empty where there is nothing."""
    return ", ".join(
        [
            f"{machine.name.node} {machine.id} ({_condition(machine)})"
            for machine in observed.machines
        ]
        + [f"{resource.kind} {resource.name}" for resource in observed.resources]
    )


def _condition(machine: MachineSeen) -> str:
    return machine.reason if machine.state is State.UNKNOWN else str(machine.state)


def _present(observed: Observed) -> Observed:
    """Leave out machines that are gone and only still listed."""
    alive = tuple(machine for machine in observed.machines if machine.state is not State.GONE)
    return Observed(alive, observed.resources)


def _is_any(observed: Observed) -> bool:
    return bool(observed.machines or observed.resources)


def _is_hidden(remains: Observed) -> bool:
    """Tell whether nothing is left but hosts that do not let us see whether anything is there."""
    return bool(remains.machines) and all(m.state is State.UNKNOWN for m in remains.machines)


def _take_away(
    provider: Provider,
    remains: Observed,
    terminate: Callable[[Sequence[MachineSeen]], None],
    step: Step,
    report: Callable[[str], None],
) -> None:
    """Do what can be done now: resources go after machines, and what proves them ours last."""
    beyond = (State.ENDING, State.UNKNOWN)
    ending = [machine for machine in remains.machines if machine.state not in beyond]
    if ending:
        report(f"terminating {_names(ending)}")
        with step(f"terminate {_names(ending)}"):
            terminate(ending)
    occupied = {machine.cluster for machine in remains.machines}
    for resource in sorted(remains.resources, key=lambda resource: resource.bears_life):
        if resource.cluster not in occupied:
            what = f"the {resource.kind} {resource.name}"
            with step(f"delete {what}"):
                is_deleted = provider.cleanup(resource)
            if is_deleted:
                report(f"deleted {what}")


def _names(machines: list[MachineSeen]) -> str:
    return ", ".join(f"{machine.name.node} ({machine.id})" for machine in machines)
