"""A network and machines for the tests of the test bed itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from testbed.machine import Machine, build_image
from testbed.metadata import MetadataService
from testbed.network import METADATA, Network, missing

StartMachine = Callable[..., Machine]
reason = missing()


@pytest.fixture
def network() -> Iterator[Network]:
    if reason:
        pytest.skip(reason)
    network = Network()
    yield network
    network.close()


@pytest.fixture
def start_machine(network: Network, tmp_path: Path) -> Iterator[StartMachine]:
    """Start machines, the first at 172.31.0.10; wait until their first boot is done."""
    machines: list[Machine] = []

    def find(address: str) -> Machine | None:
        return next((m for m in machines if m.private == address), None)

    image = build_image(tmp_path / "image")
    service = MetadataService(network.router.listen(METADATA, 80), find)

    def start(**more: Any) -> Machine:
        last = 10 + len(machines)
        machine = Machine(
            network, image, f"m-{last}", f"172.31.0.{last}", f"203.0.113.{last}", **more
        )
        machines.append(machine)
        network.publish(machine.public, machine.private)
        machine.start()
        machine.wait_for("first boot is done")
        return machine

    yield start
    for machine in machines:
        machine.power_off()
    service.close()
