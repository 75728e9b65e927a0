"""What goes wrong ends in a smaller cluster that works, or in one clear line; nothing is left."""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import pytest
from cloud import Instance
from testbed.chaos import announce_interruption, fill_disk, interrupt
from testbed.cloud import Boot
from testbed.machine import Machine
from testbed.sites import OPTIONS, POINTS, Site

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

CLOUD_FAILED = 4


def boots_of(node: str, how: Boot) -> Callable[[Instance], Boot]:
    """Let every machine that plays a node boot in some manner."""
    return lambda instance: how if f"-{node}-" in instance.token else Boot.WELL


def assert_works(site: Site, mesh: bytes, machines: int) -> None:
    assert len(site.bed.cloud.living) == machines
    site.succeed("submit", POINTS, "-o", "mesh.ply", "--", *OPTIONS)
    assert (site.bed.home / "mesh.ply").read_bytes() == mesh


def assert_one_clear_line(done: subprocess.CompletedProcess[str], *words: str) -> None:
    assert done.returncode == CLOUD_FAILED, done.stderr
    assert "Traceback" not in done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("hpcapp: "), done.stderr
    assert all(word in last for word in words), last


@pytest.mark.parametrize("how", [Boot.NEVER, Boot.WITHOUT_SSHD, Boot.WITH_FULL_DISK])
def test_worker_that_never_works_is_done_without(idle_site: Site, how: Boot) -> None:
    idle_site.bed.boots = boots_of("worker-1", how)
    idle_site.write(workers={"count": 2, "min": 1}, limits={"boot": "15s"})
    done = idle_site.succeed("up", "-y")
    assert "going without worker-1" in done.stderr
    assert len(idle_site.bed.cloud.living) == 2
    idle_site.end()


def test_too_few_machines_is_one_line(idle_site: Site) -> None:
    idle_site.bed.boots = boots_of("worker-1", Boot.WITHOUT_SSHD)
    idle_site.write(workers={"count": 1}, limits={"boot": "5s"})
    assert_one_clear_line(idle_site.hpcapp("up", "-y"), "worker-1", "refused")
    assert idle_site.bed.left() == []


def test_machine_that_dies_while_it_is_set_up_is_replaced(site: Site, mesh: bytes) -> None:
    died: list[str] = []

    def die_at_first_command(machine: Machine, line: str) -> None:
        plays = next(i.token for i in site.bed.cloud.instances if i.id == machine.name)
        if line.startswith("Starting session") and "-worker-1-" in plays and not died:
            died.append(machine.name)
            machine.power_off()
            instance = next(i for i in site.bed.cloud.instances if i.id == machine.name)
            instance.die("Server.InternalError")

    site.bed.on_line = die_at_first_command
    site.write(workers={"count": 1}, limits={"boot": "30s"})
    site.succeed("up", "-y")
    assert died
    assert_works(site, mesh, machines=2)
    site.end()


def test_spot_interruption_in_mid_job(site: Site, mesh: bytes) -> None:
    block = site.bed.cloud.provider_block(small={}, fast={"market": "spot"})
    site.write(block, head={"profile": "small"}, workers={"profile": "fast", "count": 2})
    site.succeed("up", "-y")
    job = site.start("submit", POINTS, "-o", "mesh.ply", "--", *OPTIONS)
    head = site.bed.machine("head")
    worker = site.bed.machine("worker-1")
    wait_for_job(head)
    interrupt(site.bed, announce_interruption(site.bed, "worker-1"))
    _, errors = job.communicate()
    assert job.returncode == 0, errors
    assert not worker.is_on
    assert (site.bed.home / "mesh.ply").read_bytes() == mesh
    site.succeed("up", "-y")
    assert_works(site, mesh, machines=3)
    site.end()


def wait_for_job(head: Machine) -> None:
    """Wait until the head's job has spoken of its first stage."""
    head.run(
        "n=0; until cat /home/admin/hpcapp/*/jobs/*/events.jsonl 2>/dev/null | grep -q .; do "
        "n=$((n + 1)); [ $n -lt 1200 ] || exit 1; sleep 0.05; done"
    )


def test_disk_that_fills_in_mid_life_costs_a_worker_not_the_job(site: Site, mesh: bytes) -> None:
    site.write(workers={"count": 1})
    site.succeed("up", "-y")
    fill_disk(site.bed, "worker-1")
    assert_works(site, mesh, machines=2)
    site.end()


def test_a_head_that_hangs_is_told_with_a_way_on_that_works(idle_site: Site) -> None:
    idle_site.write(workers={"count": 0}, limits={"boot": "1h"})
    idle_site.succeed("up", "-y")
    hanging = idle_site.bed.machine("head")
    hanging.freeze()
    told = idle_site.hpcapp("up", "-y")
    down = f"hpcapp down {idle_site.file.name}"
    assert_one_clear_line(told, "head cannot be had: ", "in the cloud's console", down)
    assert hanging.is_on, "it may be at work"
    idle_site.succeed(*down.split()[1:2])
    idle_site.succeed("up", "-y")
    assert idle_site.bed.machine("head") is not hanging
    idle_site.end()


def test_nothing_is_launched_for_a_head_that_is_cut_off(idle_site: Site) -> None:
    idle_site.write(workers={"count": 1}, limits={"boot": "1h"})
    idle_site.succeed("up", "-y")
    head, worker = idle_site.bed.machine("head"), idle_site.bed.instance("worker-1")
    idle_site.bed.network.cut(head.private)
    interrupt(idle_site.bed, worker)
    calls = len(idle_site.bed.cloud.calls)
    told = idle_site.hpcapp("up", "-y")
    assert_one_clear_line(told, "head cannot be had: ", "in the cloud's console")
    assert not [call.action for call in idle_site.bed.cloud.calls[calls:] if call.changes]
    assert len(idle_site.bed.cloud.living) == 1
    idle_site.end()


def test_missing_right(idle_site: Site) -> None:
    idle_site.write()
    idle_site.bed.cloud.no_rights = {"RunInstances"}
    assert_one_clear_line(idle_site.hpcapp("up", "-y"), "RunInstances")
    assert idle_site.bed.left() == []
