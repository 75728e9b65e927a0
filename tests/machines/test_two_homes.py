"""Two homes, one cluster file: the strict cloud, real SSH servers, and the verbs as typed."""

from __future__ import annotations

import json
import stat
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import paramiko
import pytest
from cloud import Instance, StrictCloud
from machines.servers import Machines
from typed import run

from hpccomponent.errors import CloudError
from hpcdeploy.install.installing import write_text
from hpcdeploy.login.access import Access
from hpcdeploy.ownership.node_keys import NodeKeys
from hpcdeploy.provider import MachineSeen
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.layout import state_folder

POINTS = Path(__file__).parents[2] / "examples/knot.ply"
CLOUD_FAILED = 4


def set_up(
    spec: ClusterSpec, machines: Sequence[MachineSeen], access: Access, report: object
) -> dict[str, str]:
    """Log in for real, and leave the keys there that the real one leaves; install nothing."""
    keys = NodeKeys(state_folder(spec.cluster) / "keys.json", (m.id for m in machines))
    failures: dict[str, str] = {}
    for machine in machines:
        pair = keys.of(machine.id)
        try:
            with access.open(machine, timeout_s=5.0) as shell:
                connection = {"public_key": pair.public, "secret_key": pair.secret}
                write_text(shell, "hpcapp/bunny/connection.json", json.dumps(connection))
                server = {
                    "server_public_key": keys.server.public,
                    "server_secret_key": keys.server.secret,
                }
                write_text(shell, "hpcapp/bunny/inventory.json", json.dumps(server))
        except CloudError as error:
            failures[machine.id] = error.problem
    return failures


@dataclass
class Lab:
    """A cloud, a cluster file that all have, and the verbs as they are typed from a home."""

    cloud: StrictCloud
    file: Path
    go_home: Callable[[str], None]
    capsys: pytest.CaptureFixture[str]

    def run(self, user: str, verb: str, *more: object) -> int:
        self.go_home(user)
        self.capsys.readouterr()
        code = run(verb, self.file, *more)
        told = self.capsys.readouterr()
        self.said = told.out + told.err
        return code

    def state(self, user: str) -> Path:
        return self.file.parent / user / "hpcapp/clusters/bunny"


@pytest.fixture(params=["aws", "euca-4.0", "generic"])
def lab(
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Iterator[Lab]:
    monkeypatch.setattr("hpcdeploy.install.bootstrap.set_up", set_up)
    monkeypatch.setattr("hpcdeploy.install.wheels.requirements.check_wheels", lambda spec, base: [])
    monkeypatch.setattr("hpcdeploy.install.user_data.user_data", lambda *about: "#!/bin/sh\n")
    monkeypatch.setattr("hpcdeploy.login.access.DENIED_S", 0.2)
    with Machines.open(tmp_path) as machines, StrictCloud(request.param, lag=0) as cloud:
        ports: list[int] = []

        def boot(instance: Instance) -> None:
            server = machines.add(port=ports[0]) if ports else machines.add()
            ports.append(server.port)
            server.keys.append(instance.public_key)
            instance.place(server.address, server.address)
            instance.console = server.console

        probe = machines.add()
        machines.stop(probe)
        ports.append(probe.port)
        cloud.on_launch = boot
        for name, text in cloud.environment().items():
            monkeypatch.setenv(name, text)
        price: dict[str, object] = {"hourly_cost": 0.1} if request.param == "generic" else {}
        file = tmp_path / "cluster.yaml"
        spec = {
            "version": 1,
            "cluster": "bunny",
            "provider": cloud.provider_block(small=price),
            "workers": {"count": 1},
            "auth": {"ssh_port": ports[0], "allow_from": ["192.0.2.0/24"]},
        }
        file.write_text(json.dumps(spec))

        def go_home(user: str) -> None:
            monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / user))
            monkeypatch.setenv("LOGNAME", user)

        yield Lab(cloud, file, go_home, capsys)


@pytest.mark.slow
def test_another_home_is_told_and_changes_nothing(lab: Lab) -> None:
    assert lab.run("anna", "up", "-y") == 0, lab.said
    before = [(instance.id, instance.tags) for instance in lab.cloud.living]
    assert len(before) == 2
    for verb, *more in (
        ("plan",),
        ("up", "-y"),
        ("scale", 0, "-y"),
        ("submit", POINTS, "-o", lab.file.with_name("mesh.ply")),
        ("ssh", "head", "true"),
    ):
        calls = len(lab.cloud.calls)
        assert lab.run("ben", verb, *more) == CLOUD_FAILED, lab.said
        assert not [call.action for call in lab.cloud.calls[calls:] if call.changes]
        told = lab.said.strip().splitlines()
        assert len(told) == 1, lab.said
        assert "cluster bunny was made elsewhere: by anna@" in told[0]
        assert "with the key SHA256:" in told[0]
        assert "there is no key of it here" in told[0]
        assert f"put its owner's key into {lab.state('ben') / 'id'}" in told[0]
        assert f"hpcapp adopt {lab.file} --key KEY" in told[0]
    assert not lab.state("ben").exists()
    assert [(instance.id, instance.tags) for instance in lab.cloud.living] == before
    assert lab.run("anna", "plan") == 0
    assert "nothing to create or change" in lab.said


@pytest.mark.slow
def test_down_of_anothers_cluster_asks_for_its_name(lab: Lab) -> None:
    assert lab.run("anna", "up", "-y") == 0, lab.said
    assert lab.run("ben", "down", "-y") == CLOUD_FAILED
    assert "give --name bunny to take it away" in lab.said
    assert len(lab.cloud.living) == 2
    assert lab.run("ben", "down", "-y", "--name", "bonny") == 2
    assert len(lab.cloud.living) == 2
    assert lab.run("ben", "down", "-y", "--name", "bunny") == 0, lab.said
    assert lab.cloud.left() == []


@pytest.mark.slow
def test_a_key_handed_over_shares_the_cluster(lab: Lab) -> None:
    assert lab.run("anna", "up", "-y") == 0, lab.said
    lab.state("ben").mkdir(parents=True)
    (lab.state("ben") / "id").write_bytes((lab.state("anna") / "id").read_bytes())
    assert lab.run("ben", "plan") == 0, lab.said
    assert "nothing to create or change" in lab.said


@pytest.mark.slow
def test_a_cluster_is_adopted_with_its_owners_key_alone(lab: Lab, tmp_path: Path) -> None:
    assert lab.run("anna", "up", "-y") == 0, lab.said
    assert lab.run("ben", "adopt", "-y") == CLOUD_FAILED
    assert "only 'hpcapp down' remains" in lab.said
    other = tmp_path / "other"
    paramiko.RSAKey.generate(2048).write_private_key_file(str(other))
    assert lab.run("ben", "adopt", "-y", "--key", other) == CLOUD_FAILED
    assert "lets in the key SHA256:" in lab.said
    assert not (lab.state("ben") / "id").exists()

    key = lab.state("anna") / "id"
    assert lab.run("ben", "adopt", "-y", "--key", key) == 0, lab.said
    kept = lab.state("ben") / "id"
    assert kept.read_bytes() == key.read_bytes()
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    keys = json.loads((lab.state("anna") / "keys.json").read_text())
    assert json.loads((lab.state("ben") / "keys.json").read_text()) == keys
    assert {i.tags["hpcapp:owner"].partition("@")[0] for i in lab.cloud.living} == {"ben"}
    assert lab.run("ben", "up", "-y") == 0, lab.said
    assert len(lab.cloud.living) == 2
    assert lab.run("ben", "down") == 0, lab.said
    assert lab.cloud.left() == []


@pytest.mark.slow
def test_a_cluster_of_an_older_release_is_its_key_pairs(lab: Lab) -> None:
    """Its machines bear no key; the key pair that they were launched with is proof."""
    assert lab.run("anna", "up", "-y") == 0, lab.said
    for instance in lab.cloud.instances:
        lab.cloud.model.backend.tags[instance.id]["hpcapp:owner"] = "anna@lab"
    for group in lab.cloud.groups:
        lab.cloud.model.backend.tags[group.id].pop("hpcapp:owner", None)
    assert lab.run("ben", "up", "-y") == CLOUD_FAILED
    assert "by anna@lab without a trace of its key" in lab.said
    (lab.state("anna") / "journal.jsonl").unlink()
    assert lab.run("anna", "plan") == 0, lab.said
    assert "would mark head, worker-1" in lab.said
    assert lab.run("anna", "up", "-y") == 0, lab.said
    assert lab.run("anna", "plan") == 0, lab.said
    assert "nothing to create or change" in lab.said


@pytest.mark.slow
def test_a_machine_that_has_worked_is_not_replaced_for_a_login_that_fails(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert lab.run("anna", "up", "-y") == 0, lab.said
    before = [instance.id for instance in lab.cloud.living]
    with monkeypatch.context() as patch:
        patch.setattr(
            "hpcdeploy.install.bootstrap.set_up",
            lambda spec, machines, access, report: {m.id: "no answer" for m in machines},
        )
        assert lab.run("anna", "up", "-y") == CLOUD_FAILED
    assert "head (and 1 more) cannot be had: no answer; it stays, for it may be at" in lab.said
    assert [instance.id for instance in lab.cloud.living] == before
