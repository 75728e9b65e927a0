"""Taking over a cluster that was made elsewhere: a way in, its keys, and its owner tag."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError, UsageError
from hpccomponent.foreign_json import decode
from hpccomponent.protocol.keys import Key, KeyPair, write_secret
from hpcdeploy.login.shell import Shell
from hpcdeploy.ownership.journal import open_journal
from hpcdeploy.ownership.node_keys import NodeKeys
from hpcdeploy.ownership.ownership import fingerprint
from hpcdeploy.provider import MachineSeen, Observed, State, Tags
from hpcdeploy.providers.clouds import places_of
from hpcdeploy.reconcile.cluster import require_same
from hpcdeploy.spec.layout import machine_folder, state_folder
from hpcdeploy.spec.names import HEAD

if TYPE_CHECKING:
    from hpcdeploy.reconcile.cluster import Cluster


AT_ONCE = 16
WAIT_S = 30.0  # these machines have answered their owner before
Told = TypeVar("Told")
_ONLY_DOWN = "without its owner's key only 'hpcapp down' remains"


@dataclass(frozen=True, slots=True)
class _OfWorker:
    """What a worker's connection file says of its keys."""

    public_key: Key
    secret_key: Key


@dataclass(frozen=True, slots=True)
class _OfMaster:
    """What the head's inventory says of the master's keys."""

    server_public_key: Key
    server_secret_key: Key


def check_way_in(cluster: Cluster, key: Path | None) -> tuple[Observed, dict[str, KeyPair]]:
    """Log in to all machines of a cluster that run; nothing is changed there.

    Return what the cloud lists of the cluster, and the keys by which master and workers know one
    another, as the machines have them. `key` is the private key that its owner has handed over; by
    default what is held here.

    Raises CloudError where there is nothing to take over, or a machine does not let us in;
    UsageError where a key is given and none is used, or it is another one than the cluster's.
    """
    spec = cluster.spec
    observed = cluster.provider.observe(spec.cluster)
    present = [m for m in observed.machines if m.state not in (State.ENDING, State.GONE)]
    if not present:
        raise CloudError(
            f"cluster {spec.cluster} has no machine that could be taken over",
            f"run hpcapp up {cluster.path}, or hpcapp down {cluster.path} to remove its rest",
        )
    _choose_key(cluster, key, present)
    for machine in present:
        if machine.state is not State.RUNNING:
            raise CloudError(
                f"{machine.name.node} ({machine.id}) is {machine.state}, not running",
                "try again when it runs, or take the cluster down",
            )
    with ThreadPoolExecutor(AT_ONCE, "adopt") as pool:
        keys_by_machine = list(pool.map(lambda machine: _read_keys(cluster, machine), present))
    return observed, {name: pair for keys in keys_by_machine for name, pair in keys.items()}


def _choose_key(cluster: Cluster, key: Path | None, present: Iterable[MachineSeen]) -> None:
    """Log in with the key that was handed over, where it is the one that fits."""
    spec, access = cluster.spec, cluster.access
    if not spec.provider.makes_machines or spec.auth.ssh_private_key != "auto":
        if key is not None:
            why = (
                "auth.ssh_private_key names it"
                if spec.provider.makes_machines
                else "hosts let in your own keys"
            )
            raise UsageError(f"--key is not used here: {why}", "leave it out")
        return
    wanted = {machine.owner.key for machine in present} - {""}
    if key is not None:
        access.use_key(key)
    elif not access.ownership().owner.key:
        raise CloudError(
            f"there is no key of cluster {spec.cluster} here",
            f"give the key of its owner by --key FILE (there it is "
            f"{state_folder(spec.cluster) / 'id'}); {_ONLY_DOWN}",
        )
    ours = fingerprint(access.public_key())
    if wanted - {ours}:
        raise CloudError(
            f"cluster {spec.cluster} lets in the key {', '.join(sorted(wanted))}, not {ours}",
            f"give that one by --key FILE; {_ONLY_DOWN}",
        )


def _read_keys(cluster: Cluster, machine: MachineSeen) -> dict[str, KeyPair]:
    """Log in, and read which keys a machine has, so that its work goes on with them."""
    with cluster.access.open(machine, WAIT_S) as shell:
        folder = machine_folder(cluster.spec.cluster)
        keys: dict[str, KeyPair] = {}
        said = _read_json(shell, f"{folder}/connection.json", _OfWorker)
        if said:
            keys[machine.id] = KeyPair(said.public_key, said.secret_key)
        inventory = _read_json(shell, f"{folder}/inventory.json", _OfMaster)
        if machine.name.node == HEAD and inventory:
            server = KeyPair(inventory.server_public_key, inventory.server_secret_key)
            keys[NodeKeys.SERVER] = server
    return keys


def _read_json(shell: Shell, path: str, kind: type[Told]) -> Told | None:
    done = shell.run(f"cat {path} 2>/dev/null")
    if done.exit_code:
        return None
    try:
        return decode(done.output, kind)
    except ValueError as error:
        raise CloudError(f"{shell.node}: {path} is damaged ({error})") from None


def take_over(
    cluster: Cluster,
    observed: Observed,
    keys: dict[str, KeyPair],
    key: Path | None,
    report: Callable[[str], None],
) -> None:
    """Keep a cluster's keys here, and write us down as its owner.

    Raises OutdatedError where it is another cluster by now than `observed`, and nothing was done;
    CloudError where the cloud or a host refuses.
    """
    name = cluster.spec.cluster
    require_same(cluster, observed, cluster.provider.observe(name))
    with open_journal(name) as journal, journal.step(f"take over the cluster {name}"):
        if key is not None:
            _keep_key(key.read_text(), state_folder(name) / "id")
        if NodeKeys.SERVER in keys:
            NodeKeys.write(state_folder(name) / "keys.json", keys)
        owner = cluster.access.owner()
        machines = [m for m in observed.machines if m.state is State.RUNNING]
        cluster.provider.tag(machines, Tags(owner), observed.lives)
        journal.note_places(places_of(cluster.spec))
    report(f"cluster {name} is {owner.user}'s now: {len(machines)} machines")


def _keep_key(text: str, path: Path) -> None:
    """Keep a private key; one that was there before stays beside it."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    if path.exists() and path.read_text() != text:
        os.replace(path, path.with_name("id.before"))
    write_secret(path, text)
