"""The loader and the guard as services of systemd, on machines that it really runs."""

from __future__ import annotations

import pytest
from testbed.machine import Machine
from testbed.sites import OPTIONS, POINTS, Site

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]

LOADER, GUARD = "hpcapp-bunny.service", "hpcapp-guard.service"


def show(machine: Machine, unit: str, name: str) -> str:
    return machine.run(f"systemctl show --value -p {name} {unit}").strip()


def assert_comes_back(machine: Machine, unit: str) -> None:
    """Kill a service's process with -9; systemd starts another, which stays."""
    assert show(machine, unit, "ActiveState") == "active"
    first = show(machine, unit, "MainPID")
    machine.run(
        f"kill -KILL {first}\n"
        f"until [ $(systemctl show --value -p NRestarts {unit}) = 1 ] &&"
        f" systemctl is-active -q {unit}; do sleep 0.1; done"
    )
    assert show(machine, unit, "MainPID") not in ("0", first)


def test_cloud(site: Site, mesh: bytes) -> None:
    site.write()
    site.succeed("up", "-y")
    head, worker = site.bed.machine("head"), site.bed.machine("worker-1")
    assert worker.run("cat /proc/1/comm") == "systemd\n"
    for machine in (head, worker):
        assert show(machine, LOADER, "UnitFileState") == "enabled"
        assert show(machine, LOADER, "User") == "admin"
    assert_comes_back(worker, LOADER)
    assert_comes_back(worker, GUARD)
    site.succeed("submit", POINTS, "-o", "mesh.ply", "--", *OPTIONS)
    assert (site.bed.home / "mesh.ply").read_bytes() == mesh

    instance = site.bed.instance("worker-1")
    worker.run("sed -i 's/^lease_until .*/lease_until 1/' /var/lib/hpcapp/limits")
    worker.wait_for_end()
    assert "guard: the lease is over; shutting down" in worker.console()
    assert instance.state in ("shutting-down", "terminated")
    site.end()
    assert not head.is_on


def test_host_is_left_as_it_was(idle_site: Site) -> None:
    site = idle_site
    folder = site.bed.home / ".ssh"
    folder.mkdir(mode=0o700)
    site.bed.run("ssh-keygen", "-q", "-t", "rsa", "-N", "", "-f", str(folder / "id_rsa"))
    host = site.bed.add_host((folder / "id_rsa.pub").read_bytes())
    key = host.run("cut -d' ' -f1,2 /etc/ssh/ssh_host_ed25519_key.pub")
    (folder / "known_hosts").write_text(f"{host.public} {key}")
    host.run("su admin -c 'sudo -n true'")  # which leaves a mark at its first use
    before = host.run("ls -AR /etc/systemd /home")
    address = {"address": host.public, "private_address": host.private}
    site.write({"type": "ssh", "hosts": [address]}, workers={"count": 0})
    site.succeed("up", "-y")
    assert show(host, LOADER, "ActiveState") == "active"
    assert "head: good" in site.succeed("doctor").stdout
    done = site.hpcapp("exec", "--all", "--", "sh", "-c", "'id -un; exit 3'")
    assert (done.returncode, done.stdout) == (3, "head: admin\n"), done.stderr
    pid = show(host, LOADER, "MainPID")
    site.end()
    assert show(host, LOADER, "LoadState") == "not-found"
    assert host.run("ls -AR /etc/systemd /home") == before
    assert host.run(f"[ -e /proc/{pid} ] || echo gone") == "gone\n"
