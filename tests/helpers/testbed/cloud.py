"""The test bed: the strict EC2 endpoint with machines of the test bed for its instances.

::

    with TestBed(folder, "aws") as bed:
        bed.boots = lambda instance: Boot.NEVER if "-worker-2-1" in instance.token else Boot.WELL
        done = bed.run("hpcapp", "up", "cluster.yaml")            # on the laptop
        bed.machine("worker-1").power_off()
        assert not bed.left()

The cluster's front is `bed.cloud`, see `cloud`; `bed.hook` is called as its hook would be.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from enum import Enum, auto
from pathlib import Path
from typing import Any, Self

from cloud import Call, Instance, StrictCloud

from testbed.machine import DISK_MB, Machine, build_image
from testbed.metadata import MetadataService
from testbed.network import ENDPOINT, METADATA, Network, Permission

ENDPOINT_PORT = 8773


class Boot(Enum):
    """How an instance boots."""

    WELL = auto()
    WITHOUT_SSHD = auto()
    WITH_FULL_DISK = auto()
    NEVER = auto()  # it runs, says the cloud, but nothing ever answers


SMALL_DISK_MB = 24


class TestBed:
    """A cloud with a laptop.

    Parameters
    ----------
    folder : Path
        Of the test; the laptop's home is in it.
    profile : str
        Of the cloud: ``aws``, ``euca-4.0`` ... ``euca-5.1``, ``generic``.
    machine_type : type
        `Machine`, or one that boots otherwise.
    """

    __test__ = False

    def __init__(
        self, folder: Path, profile: str = "aws", machine_type: type[Machine] = Machine
    ) -> None:
        self._machine_type = machine_type
        self.boots: Callable[[Instance], Boot] = lambda _: Boot.WELL
        self.hook: Callable[[Call, str], None] | None = None
        self.on_line: Callable[[Machine, str], None] | None = None
        self.home = folder / "home"
        self.home.mkdir()
        self._image = build_image(folder / "image")
        self._machines: dict[str, Machine] = {}
        self._hosts: list[Machine] = []
        self._lock = threading.RLock()
        with ExitStack() as stack:
            self.network = Network()
            stack.callback(self.network.close)
            router = self.network.router
            metadata = MetadataService(router.listen(METADATA, 80), self._machine_at)
            stack.callback(metadata.close)
            listening = stack.enter_context(router.listen(ENDPOINT, ENDPOINT_PORT))
            self.cloud = stack.enter_context(
                StrictCloud(profile, pending=None, listening=listening)
            )
            stack.callback(self._switch_off)
            self._boots = stack.enter_context(ThreadPoolExecutor(4, "boot"))
            self._closing = stack.pop_all()
        self.cloud.hook = self._on_call
        self.cloud.on_launch = self._launch
        self.cloud.on_terminate = self._terminate

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._closing.close()

    # what a test does ---------------------------------------------------------------------

    def machine(self, node: str) -> Machine:
        """Return the machine that is on and plays a node: ``head``, ``worker-1``, ..."""
        for instance in self.cloud.living:
            if f"-{node}-" in instance.token and self._machines[instance.id].is_on:
                return self._machines[instance.id]
        raise LookupError(node)

    def instance(self, node: str) -> Instance:
        """Return the living instance that plays a node."""
        return next(i for i in self.cloud.living if f"-{node}-" in i.token)

    def add_host(self, public_key: bytes) -> Machine:
        """Switch on a machine that the cloud knows nothing of, open to all."""
        with self._lock:
            last = 10 + len(self._machines)
            machine = self._machine_type(
                self.network, self._image, f"host-{last}", f"172.31.0.{last}",
                f"203.0.113.{last}", public_key=public_key, on_line=self.on_line,
            )  # fmt: skip
            self._machines[machine.name] = machine
            self._hosts.append(machine)
        self.network.publish(machine.public, machine.private)
        machine.start()
        self._judge()
        machine.wait_for("first boot is done")
        return machine

    def machines(self) -> Iterator[Machine]:
        """Return all machines that ever were."""
        return iter(tuple(self._machines.values()))

    def left(self) -> list[str]:
        """Name what the cloud still has, and machines that are on for no instance of it."""
        living = {i.id for i in self.cloud.living} | {host.name for host in self._hosts}
        astray = [m.name for m in self.machines() if m.is_on and m.name not in living]
        return self.cloud.left() + astray

    def environment(self) -> dict[str, str]:
        """Return the environment of the laptop's user, who has this cloud's keys."""
        programs = f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"
        kept = {name: value for name, value in os.environ.items() if name == "LANG"}
        return kept | {"HOME": str(self.home), "PATH": programs} | self.cloud.environment()

    def start(self, *command: str, **more: Any) -> subprocess.Popen[str]:
        """Start a program on the laptop, in its home."""
        environment = self.environment() | more.pop("env", {})
        return subprocess.Popen(
            [*self.network.laptop.prefix, *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=self.home,
            env=environment,
            **more,
        )

    def run(self, *command: str, **more: Any) -> subprocess.CompletedProcess[str]:
        """Run a program on the laptop to its end."""
        process = self.start(*command, **more)
        with process:
            output, errors = process.communicate()
        return subprocess.CompletedProcess(command, process.returncode, output, errors)

    def _switch_off(self) -> None:
        for machine in self.machines():
            machine.power_off()

    # what the cloud does ------------------------------------------------------------------

    def _machine_at(self, address: str) -> Machine | None:
        return next((m for m in self.machines() if m.private == address and m.is_on), None)

    def _on_call(self, call: Call, moment: str) -> None:
        if call.action == "GetConsoleOutput" and moment == "before":
            for instance in self.cloud.instances:
                if instance.id in self._machines:
                    instance.console = self._machines[instance.id].console()
        if "SecurityGroup" in call.action and moment == "after":
            self._judge()
        if self.hook is not None:
            self.hook(call, moment)

    def _launch(self, instance: Instance) -> None:
        with self._lock:
            last, how = 10 + len(self._machines), self.boots(instance)
            machine = self._machine_type(
                self.network,
                self._image,
                instance.id,
                f"172.31.0.{last}",
                f"203.0.113.{last}",
                public_key=instance.public_key.encode(),
                user_data=instance.user_data,
                has_sshd=how is not Boot.WITHOUT_SSHD,
                disk_mb=SMALL_DISK_MB if how is Boot.WITH_FULL_DISK else DISK_MB,
                on_power_off=lambda _: self._shut_down(instance),
                on_line=self.on_line,
            )
            self._machines[instance.id] = machine
        instance.place(machine.private, machine.public)
        self._boots.submit(self._boot, instance, machine, how)

    def _boot(self, instance: Instance, machine: Machine, how: Boot) -> None:
        with self._lock:
            if instance.state != "pending":
                return
            if how is not Boot.NEVER:
                self.network.publish(machine.public, machine.private)
                machine.start()
            instance.boot()
        self._judge()

    def _shut_down(self, instance: Instance) -> None:
        """A guest switched itself off."""
        instance.shut_down()
        self._judge()

    def _terminate(self, instance: Instance) -> None:
        with self._lock:
            self._machines[instance.id].power_off()
        self._judge()

    def _judge(self) -> None:
        """Carry the cloud's security groups over to the network."""
        living = self.cloud.living
        members: dict[str, list[str]] = {}
        for instance in living:
            for name in instance.groups:
                members.setdefault(name, []).append(instance.private_address)
        rules = [(g.name, rule) for g in self.cloud.groups for rule in g.ingress_rules]
        names = {group.id: group.name for group in self.cloud.groups}
        permissions = [
            Permission(target, source, f"{rule.from_port}-{rule.to_port}")
            for name, rule in rules
            for target in members.get(name, [])
            for source in _sources(rule, names, members)
        ]
        hosts = [Permission(host.private, "0.0.0.0/0", "1-65535") for host in self._hosts]
        self.network.permit(permissions + hosts)


def _sources(rule: Any, names: dict[str, str], members: dict[str, list[str]]) -> list[str]:
    """Return the networks and machines that one rule of moto lets in."""
    group = rule.source_group or {}
    name = group.get("GroupName") or names.get(group.get("GroupId", ""), "")
    network = (rule.ip_range or {}).get("CidrIp")
    return ([network] if network else []) + members.get(name, [])
