"""One cluster file, but for its provider's block, works on every kind of cloud."""

from __future__ import annotations

import pytest
from testbed.sites import OPTIONS, POINTS, MakeSite, Site

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def run_through(site: Site, mesh: bytes) -> None:
    """Up, one job, its mesh, and down."""
    site.succeed("up", "-y")
    site.succeed("submit", POINTS, "-o", "mesh.ply", "--", *OPTIONS)
    assert (site.bed.home / "mesh.ply").read_bytes() == mesh
    site.end()


@pytest.mark.parametrize("profile", ["euca-4.0", "generic"])
def test_cloud(make_site: MakeSite, profile: str) -> None:
    site = make_site(profile, idle=True)
    site.write()
    site.succeed("validate")
    site.succeed("up", "-y")
    site.end()


def test_job_on_a_private_cloud(make_site: MakeSite, mesh: bytes) -> None:
    site = make_site("euca-5.1")
    site.write()
    run_through(site, mesh)


def test_ssh_hosts(site: Site, mesh: bytes) -> None:
    folder = site.bed.home / ".ssh"
    folder.mkdir(mode=0o700)
    site.bed.run("ssh-keygen", "-q", "-t", "rsa", "-N", "", "-f", str(folder / "id_rsa"))
    hosts = [site.bed.add_host((folder / "id_rsa.pub").read_bytes()) for _ in range(2)]
    known = (
        f"{host.public} {line}\n"
        for host in hosts
        for line in host.console().splitlines()
        if line.startswith("ssh-ed25519 ")
    )
    (folder / "known_hosts").write_text("".join(known))
    addresses = [{"address": h.public, "private_address": h.private} for h in hosts]
    site.write({"type": "ssh", "hosts": addresses})
    run_through(site, mesh)
    for host in hosts:
        assert host.run("ls -A /home/admin").split() == [".ssh"]
        assert "hpcloader" not in host.run("cat /proc/[0-9]*/cmdline")


def test_local(site: Site, mesh: bytes) -> None:
    site.write({"type": "local"}, auth={}, env={})
    run_through(site, mesh)
    assert str(site.bed.home) not in site.bed.run("ps", "ax").stdout
