"""Turn running machines into members of a cluster: package, keys, loader, inventory.

::

    probe all ──> one release for all ──> each: install ─> keys ─> loader      16 at once
                                                     └──> inventory on the head

What is in place already is known by two stamps on the machine, of what is installed and of how
the loader is configured, so that a second run changes nothing.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

from hpccomponent.cli.terminal import write_block
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError, HpcError
from hpccomponent.inventory import Inventory, InventoryWorker, dump_inventory
from hpccomponent.protocol.connection import Connection
from hpccomponent.runtime.numerics import package_version
from hpcdeploy.install.installing import install, install_here, prepare, stamp_of, write_text
from hpcdeploy.install.loader_service import start_loader, stop_command
from hpcdeploy.install.probe import (
    DAMAGED,
    RELEASE_COMMAND,
    Probed,
    check_this_python,
    no_python,
    probe,
)
from hpcdeploy.install.user_data import extend_lease
from hpcdeploy.install.wheels.requirements import MachineNeeds, choose_release, needs_of
from hpcdeploy.login.access import Access
from hpcdeploy.login.shell import MOST_REASON, Shell, sha256_of
from hpcdeploy.ownership.node_keys import NodeKeys
from hpcdeploy.provider import MachineSeen
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.layout import machine_folder, state_folder
from hpcdeploy.spec.names import HEAD, without_node

T = TypeVar("T")
R = TypeVar("R")

AT_ONCE = 16
CHECK_S = 60.0
RESTART = {"first_s": 0.5, "cap_s": 2.0}  # workers come back within seconds of the next master
MIN_FREE = 1 << 29  # bytes: the environment of a head takes 0.4 GB


@dataclass(frozen=True, slots=True)
class _Member:
    machine: MachineSeen
    shell: Shell
    probed: Probed
    is_prepared: bool = False
    """Whether `env.setup` has been run already, because there was no Python."""


def set_up(
    spec: ClusterSpec,
    machines: Sequence[MachineSeen],
    access: Access,
    report: Callable[[str], None],
) -> dict[str, str]:
    """Make these machines the cluster: what is in place already stays as it is.

    `machines` are all that run, the head among them. The inventory on the head has all but those
    that do not work: why, is returned by their ids. Raises CloudError where there is no head, or no
    release for these machines.
    """
    head = next((machine for machine in machines if machine.name.node == HEAD), None)
    if head is None:
        raise CloudError(f"cluster {spec.cluster} has no head that runs", "run hpcapp up again")
    return _SetUp(spec, access, report, head).run(machines)


class _SetUp:
    """One run over all machines."""

    def __init__(
        self,
        spec: ClusterSpec,
        access: Access,
        report: Callable[[str], None],
        head: MachineSeen,
    ) -> None:
        self._spec = spec
        self._access = access
        self._report = report
        self._head = head
        self._folder = machine_folder(spec.cluster)
        self._is_here = spec.provider.is_here

    def run(self, machines: Sequence[MachineSeen]) -> dict[str, str]:
        """Set all up; tell why some machines cannot be, by their ids."""
        keys_file = state_folder(self._spec.cluster) / "keys.json"
        self._keys = NodeKeys(keys_file, (machine.id for machine in machines))
        members, unreachable = self._each(machines, lambda machine: machine, self._join)
        try:
            release = self._choose_release(members)
            done, failed = self._each(
                members, lambda member: member.machine, lambda member: self._equip(member, release)
            )
            if any(member.machine.id == self._head.id for member in done):
                self._write_inventory(done)
            return unreachable | failed
        finally:
            for member in members:
                member.shell.close()

    def _each(
        self, items: Sequence[T], machine_of: Callable[[T], MachineSeen], step: Callable[[T], R]
    ) -> tuple[list[R], dict[str, str]]:
        """Do one step for all, several at once; tell what came of it, and why machines failed."""
        pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="set-up")
        try:
            futures = [pool.submit(step, item) for item in items]
            results: list[R] = []
            failures: dict[str, str] = {}
            for item, future in zip(items, futures, strict=True):
                try:
                    results.append(future.result())
                except (HpcError, OSError) as error:
                    machine = machine_of(item)
                    reason = without_node(str(error), machine.name.node)
                    if isinstance(error, HpcError) and error.excerpt:
                        self._report(f"{machine.name.node}:\n{write_block(error.excerpt)}")
                    failures[machine.id] = reason
            return results, failures
        except BaseException:
            self._access.close()  # an interrupt must not wait for what a machine is doing
            raise
        finally:
            pool.shutdown(cancel_futures=True)

    def _join(self, machine: MachineSeen) -> _Member:
        """Log in and look."""
        shell = self._access.open(machine)
        env = self._spec.env
        try:
            probed = probe(shell, self._spec.cluster, self._folder, env.python)
            if self._is_here:
                check_this_python(env.python)
                return _Member(machine, shell, probed)
            is_prepared = not probed.kinds and bool(env.setup)
            if is_prepared:
                prepare(shell, env.setup, self._report)
                probed = probe(shell, self._spec.cluster, self._folder, env.python)
            if not probed.kinds:
                raise no_python(probed, env.python)
            return _Member(machine, shell, probed, is_prepared)
        except BaseException:
            shell.close()
            raise

    def _choose_release(self, members: Sequence[_Member]) -> Path | str:
        if self._is_here or not members:
            return ""
        kinds = [kind for member in members for _, kind in member.probed.kinds[:1]]
        return choose_release(self._spec, self._access.base, kinds)

    def _equip(self, member: _Member, release: Path | str) -> _Member:
        """Install what is not installed, and start the loader where it is not as it should be."""
        was_installed = self._install(member, release)
        lease = member.machine.lease_until
        if self._spec.provider.makes_machines and lease is not None:
            extend_lease(member.shell, lease)
        self._serve(member, is_stale=not was_installed)
        return member

    def _install(self, member: _Member, release: Path | str) -> bool:
        """Make the environment; True where it was there already."""
        shell, probed = member.shell, member.probed
        is_whole = probed.release == package_version()
        if probed.installed and not is_whole:
            state = {"": "gone", DAMAGED: "damaged"}.get(probed.release, f"hpcapp {probed.release}")
            self._report(f"{shell.node}: what was installed is {state}")
        if self._is_here:
            stamp = stamp_of(sys.executable)
            if probed.installed == stamp and is_whole:
                return True
            install_here(shell, self._folder)
        else:
            is_head = member.machine.name.node == HEAD
            python, needs = self._needs(probed, release, is_head)
            env = self._spec.env
            digests = [sha256_of(path) for path in needs.files]
            stamp = stamp_of(python, digests, needs.requirements, needs.release, env.setup)
            if probed.installed == stamp and is_whole:
                return True
            if probed.free < MIN_FREE:
                raise CloudError(
                    f"its disk has {probed.free >> 20} MiB left, {MIN_FREE >> 20} are needed",
                    "set disk_gb in its profile, or make room",
                )
            setup = () if member.is_prepared else env.setup
            install(shell, self._folder, python, needs, setup, self._report)
            self._check_version(shell)
        write_text(shell, f"{self._folder}/installed", stamp)
        return False

    def _needs(
        self, probed: Probed, release: Path | str, is_head: bool
    ) -> tuple[str, MachineNeeds]:
        """Return the first interpreter that has all its wheels, and what it needs."""
        complaint = ""
        for python, kind in probed.kinds:
            needs, missing = needs_of(self._spec, self._access.base, release, kind, is_head=is_head)
            if not missing:
                return python, needs
            complaint = complaint or f"the wheelhouse has no {', '.join(missing)} for {kind}"
        raise CloudError(complaint, "add the wheels, see hpcapp plan")

    def _check_version(self, shell: Shell) -> None:
        """Start what has been installed once; a package of the user's own may be another one."""
        command = f"cd {self._folder} && venv/bin/python -P -m hpcloader facts >/dev/null"
        done = shell.run(f"{command} && {RELEASE_COMMAND}", timeout_s=CHECK_S)
        if done.exit_code:
            raise CloudError(f"the installed loader does not start: {done.reason}")
        if (release := done.output.strip()) not in (package_version(), DAMAGED):
            raise CloudError(
                f"hpcapp {release[:MOST_REASON]} is installed, here runs {package_version()}",
                "let env.package be auto, or the same release",
            )

    def _serve(self, member: _Member, *, is_stale: bool) -> None:
        """See to it that the loader runs with these very files, or not at all."""
        shell, probed, spec = member.shell, member.probed, self._spec
        if member.machine.name.node == HEAD and not spec.head.component:
            if probed.is_running:
                shell.run(stop_command(spec.cluster, self._folder))
            return
        connection = json.dumps(asdict(self._connection(member.machine)), indent=2) + "\n"
        settings = {
            "version": 1,
            "name": member.machine.name.node,
            "connection": "connection.json",
            "restart": RESTART,
        }
        loader = json.dumps(settings, indent=2) + "\n"  # JSON is YAML too
        stamp = stamp_of(connection, loader)
        if probed.is_running and probed.configured == stamp and not is_stale:
            return
        write_text(shell, f"{self._folder}/connection.json", connection)
        write_text(shell, f"{self._folder}/loader.yaml", loader)
        start_loader(
            shell,
            spec.cluster,
            self._folder,
            user=probed.user,
            home=probed.home,
            has_systemd=probed.has_systemd and probed.is_root_able and not self._is_here,
        )
        write_text(shell, f"{self._folder}/configured", stamp)
        self._report(f"{shell.node}: its loader runs")

    def _connection(self, machine: MachineSeen) -> Connection:
        pair = self._keys.of(machine.id)
        return Connection(
            endpoint=f"tcp://{_address(self._head)}:{self._spec.communicator.port}",
            server_key=self._keys.server.public,
            public_key=pair.public,
            secret_key=pair.secret,
            worker=machine.name.node,
        )

    def _write_inventory(self, members: Sequence[_Member]) -> None:
        """Tell the HPC App, on the head, which workers it may admit."""
        [head] = [member for member in members if member.machine.id == self._head.id]
        workers = tuple(
            InventoryWorker(
                member.machine.name.node,
                _address(member.machine),
                self._keys.of(member.machine.id).public,
            )
            for member in members
            if member is not head or self._spec.head.component
        )
        text = dump_inventory(
            Inventory(
                cluster=self._spec.cluster,
                bind=f"tcp://{_address(self._head)}:{self._spec.communicator.port}",
                server_public_key=self._keys.server.public,
                server_secret_key=self._keys.server.secret,
                workers=workers,
            )
        )
        path = f"{self._folder}/inventory.json"
        previous = head.shell.run(f"cat {path} 2>/dev/null").output
        if previous != text:
            write_text(head.shell, path, text)
            self._report(f"{HEAD}: knows {len(workers)} workers")


def _address(machine: MachineSeen) -> str:
    """Return where the other machines reach it."""
    return machine.private_address or machine.public_address
