"""From a file with SSH hosts to machines that work: a real environment, real loaders, real keys."""

from __future__ import annotations

import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from heads import install_python
from machines.hosts import claim
from machines.servers import Machines, Server
from typed import run

from hpcapp.cli import hpcapp
from hpccomponent.errors import CloudError, LeftoverError, UsageError
from hpcdeploy.cli.doctor import doctor
from hpcdeploy.cli.shell import get, put
from hpcdeploy.install.bootstrap import set_up
from hpcdeploy.provider import Launch, State
from hpcdeploy.reconcile.cluster import open_cluster
from hpcdeploy.reconcile.converge import bring_up, look_ahead, take_down
from hpcdeploy.reconcile.plan import LaunchNode, Terminate
from hpcdeploy.spec.job_folder import JobOrder, create_job
from hpcdeploy.spec.names import NodeName
from hpcdeploy.spec.polling import Polling

FOLDER = "hpcapp/lab"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_hosts_become_a_cluster_whatever_they_bring_along_and_are_left_as_they_were(
    file: Path, hosts: tuple[Server, Server], wheelhouse: Path, tmp_path: Path
) -> None:
    (file.parent / "wheels").rmdir()
    (file.parent / "wheels").symlink_to(wheelhouse)
    for host in hosts:
        (host.home / "theirs").write_text("stays")
    said: list[str] = []
    with open_cluster(file) as cluster:
        claim(cluster)
        assert set_up(cluster.spec, cluster.machines(), cluster.access, said.append) == {}
        worker, image = hosts[1].home / FOLDER, tmp_path / "image"
        assert not list(worker.glob("venv/lib/python*/site-packages/scipy"))
        assert (hosts[0].home / FOLDER / "venv/bin/hpcapp").exists()
        again: list[str] = []
        assert set_up(cluster.spec, cluster.machines(), cluster.access, again.append) == {}
        assert again == []
        shutil.copytree(worker, image, symlinks=True)
        shutil.rmtree(next(worker.glob("venv/lib/python*/site-packages/zmq")))
        assert set_up(cluster.spec, cluster.machines(), cluster.access, again.append) == {}
        assert again[0] == "worker-1: what was installed is damaged"
        assert again[-1] == "worker-1: its loader runs"
        result = CliRunner().invoke(doctor, [str(file)])
        assert result.exit_code == 0, result.output
        assert "worker-1: good" in result.output
        cluster.provider.terminate(cluster.machines())
        assert cluster.machines() == ()
        # The old node's programs, and a way to an HPC App that is not ours, as an image keeps them.
        for name in ("loader.yaml", "connection.json", "machine.json"):
            (image / name).write_text("of another cluster")
        shutil.copytree(image, worker, symlinks=True)
        claim(cluster)
        assert set_up(cluster.spec, cluster.machines(), cluster.access, print) == {}
        result = CliRunner().invoke(doctor, [str(file)])
        assert result.exit_code == 0, result.output
        assert "worker-1: good" in result.output
        cluster.provider.terminate(cluster.machines())
    for host in hosts:
        assert (host.home / "theirs").read_text() == "stays"
        assert not (host.home / "hpcapp").exists()


def test_missing_wheels_fail_each_machine_with_one_line(file: Path) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
        failures = set_up(cluster.spec, cluster.machines(), cluster.access, print)
        assert failures.keys() == {machine.id for machine in cluster.machines()}
    for reason in failures.values():
        assert "the wheelhouse has no" in reason
        assert "\n" not in reason


@pytest.mark.slow
def test_a_full_disk_fails_its_machine_with_one_line_and_nothing_is_sent(
    file: Path, hosts: tuple[Server, Server], wheelhouse: Path, tmp_path: Path
) -> None:
    (file.parent / "wheels").rmdir()
    (file.parent / "wheels").symlink_to(wheelhouse)
    df = tmp_path / "programs/df"
    df.parent.mkdir()
    df.write_text("#!/bin/sh\necho; echo tmpfs 20480 18432 2048 90% /home\n")
    df.chmod(0o755)
    for host in hosts:
        host.path = f"{df.parent}:{host.path}"
    with open_cluster(file) as cluster:
        claim(cluster)
        failures = set_up(cluster.spec, cluster.machines(), cluster.access, print)
    said = "its disk has 2 MiB left, 512 are needed; set disk_gb in its profile, or make room"
    assert list(failures.values()) == [said, said]
    assert not (hosts[1].home / FOLDER / "wheels").exists()


def test_a_host_that_vanished_counts_as_stopped_with_the_reason(
    file: Path, hosts: tuple[Server, Server], machines: Machines
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
        machines.stop(hosts[1])
        head, worker = cluster.provider.observe("lab").machines
        assert (head.state, worker.state) == (State.RUNNING, State.UNKNOWN)
        assert "connection refused" in worker.reason
        owner = cluster.access.owner()
        with pytest.raises(CloudError, match="connection refused"):
            cluster.provider.launch(Launch("lab", "life", NodeName("worker-1"), owner=owner))


def test_a_host_whose_claim_is_damaged_is_named_and_the_others_are_served(
    file: Path, hosts: tuple[Server, Server]
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    place = hosts[1].home / FOLDER / "machine.json"
    place.write_text("{")
    done = CliRunner().invoke(hpcapp, ["exec", str(file), "--all", "echo here"])
    assert (done.exit_code, done.stdout) == (4, "head: here\n")
    why = "cannot be looked at: hpcapp/lab/machine.json cannot be read"
    [told] = [line for line in done.stderr.splitlines() if why in line]
    assert told.startswith("worker-1")
    table = CliRunner().invoke(hpcapp, ["status", str(file), "--offline"]).output.splitlines()
    assert table[0] == "cluster lab (ssh): up, worker-1 cannot be looked at"
    with open_cluster(file) as cluster, pytest.raises(LeftoverError, match="worker-1") as caught:
        take_down(cluster, print, polling=Polling(poll_s=0.01))
    assert "machine.json cannot be read" in caught.value.problem
    assert not (hosts[0].home / FOLDER).exists()
    assert place.exists()


@pytest.mark.parametrize("is_silent", [False, True])
def test_a_host_does_not_become_the_head_by_its_claim(
    file: Path, hosts: tuple[Server, Server], machines: Machines, is_silent: bool
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
        place = hosts[1].home / FOLDER / "machine.json"
        lie = {"node": "head", "generation": 1 << 30}
        place.write_text(json.dumps(json.loads(place.read_text()) | lie))
        if is_silent:
            machines.stop(hosts[0])
        named = {m.id: m.name.node for m in cluster.provider.observe("lab").machines}
        assert list(named.values()) == ["head", "worker-1"]
        assert list(named) == [host.id for host in cluster.provider.hosts()]
        assert not [a for a in look_ahead(cluster).actions if isinstance(a, Terminate)]


def test_a_host_does_not_make_the_others_those_of_an_earlier_life(
    file: Path, hosts: tuple[Server, Server]
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
        place = hosts[1].home / FOLDER / "machine.json"
        place.write_text(json.dumps(json.loads(place.read_text()) | {"incarnation": "z"}))
        ended = [a.machines for a in look_ahead(cluster).actions if isinstance(a, Terminate)]
    assert [machine.name.node for machines in ended for machine in machines] == ["worker-1"]


def test_hosts_that_changed_places_in_the_file_keep_their_names(file: Path) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    spec = json.loads(file.read_text())
    spec["provider"]["hosts"].reverse()
    file.write_text(json.dumps(spec))
    with open_cluster(file) as cluster:
        seen = cluster.provider.observe("lab").machines
        assert [machine.name.node for machine in seen] == ["worker-1", "head"]


def test_down_names_a_host_that_does_not_answer_and_leaves_the_others_clean(
    file: Path, hosts: tuple[Server, Server], machines: Machines
) -> None:
    said: list[str] = []
    polling = Polling(poll_s=0.01, end_s=600.0)
    with open_cluster(file) as cluster:
        claim(cluster)
        machines.stop(hosts[1])
        with pytest.raises(LeftoverError) as caught:
            take_down(cluster, said.append, polling=polling)
        assert caught.value.exit_code == 4
        assert "worker-1" in caught.value.problem
        assert "connection refused" in caught.value.problem
        assert "head" not in caught.value.problem
        assert not (hosts[0].home / "hpcapp").exists()
        machines.start(hosts[1], hosts[1].port)
        take_down(cluster, said.append, polling=polling)
    assert not (hosts[1].home / "hpcapp").exists()


def test_commands_run_on_all_and_the_worst_code_counts(
    file: Path, hosts: tuple[Server, Server], capfd: pytest.CaptureFixture[str]
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    (hosts[1].home / "bad").touch()
    command = "echo here; test ! -e bad || exit 7"
    assert run("exec", file, "--all", command) == 7
    assert sorted(capfd.readouterr().out.splitlines()) == ["head: here", "worker-1: here"]


def test_files_go_to_the_head_and_come_back(
    file: Path, hosts: tuple[Server, Server], tmp_path: Path
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    (tmp_path / "cloud.ply").write_bytes(b"ply\n" * 1000)
    assert CliRunner().invoke(put, [str(file), str(tmp_path / "cloud.ply")]).exit_code == 0
    assert (hosts[0].home / "cloud.ply").stat().st_size == 4000
    target = tmp_path / "back.ply"
    assert CliRunner().invoke(get, [str(file), "cloud.ply", str(target)]).exit_code == 0
    assert target.read_bytes() == b"ply\n" * 1000


@pytest.mark.slow
def test_a_host_that_hides_what_it_does_is_never_ended_nor_replaced(
    file: Path, hosts: tuple[Server, Server], machines: Machines, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    claims = [host.home / FOLDER / "machine.json" for host in hosts]
    known_hosts = file.parent / "user/.ssh/known_hosts"
    known = known_hosts.read_text()
    for hide, why in (
        (lambda: known_hosts.write_text(""), "is not known"),
        (hosts[1].keys.clear, "permission denied"),
        (lambda: machines.stop(hosts[1]), "connection refused"),
    ):
        hide()
        with open_cluster(file) as cluster:
            ahead = look_ahead(cluster)
        assert not [a for a in ahead.actions if isinstance(a, Terminate | LaunchNode)]
        assert any("worker-1" in line and why in line for line in ahead.obstacles())
        for verb in (["plan"], ["up", "-y"], ["scale", "1", "-y"], ["status"]):
            run(verb[0], file, *verb[1:])
            told = capsys.readouterr()
            assert "terminate" not in told.out + told.err
            assert why in told.out + told.err
        assert all(path.exists() for path in claims)
        known_hosts.write_text(known)


def test_hosts_that_another_home_has_claimed_are_adopted_on_purpose(
    file: Path,
    hosts: tuple[Server, Server],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    monkeypatch.setenv("XDG_STATE_HOME", str(file.parent / "ben"))
    for words in (("plan",), ("up", "-y"), ("scale", "0", "-y"), ("down", "-y")):
        assert run(words[0], file, *words[1:]) == 4
        assert "cluster lab was made elsewhere: by " in capsys.readouterr().err
    assert all((host.home / FOLDER / "machine.json").exists() for host in hosts)
    assert run("adopt", file, "-y") == 0
    assert run("plan", file) == 0
    assert "nothing to create or change" in capsys.readouterr().out


def test_adopt_says_which_jobs_run_and_which_option_answers_for_the_user(
    file: Path, hosts: tuple[Server, Server], monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    folder = hosts[0].home / FOLDER
    place = folder / "machine.json"
    install_python(folder)
    monkeypatch.setenv("XDG_STATE_HOME", str(file.parent / "ben"))
    order = JobOrder("reconstruct", "points/x.ply", "mesh.ply", title="scan.ply")
    _, lock = create_job(folder, order)
    try:
        asked = CliRunner().invoke(hpcapp, ["adopt", str(file)], input="", standalone_mode=False)
        assert "job 1 (scan.ply) is queued; it goes on" in asked.output
        for path, key in ((folder / "jobs/1/status.json", "title"), (place, "owner")):
            path.write_text(
                json.dumps(json.loads(path.read_text()) | {key: "a\nnobody-uses-it\nb"})
            )
        lied = CliRunner().invoke(hpcapp, ["adopt", str(file)], input="", standalone_mode=False)
        assert lied.output.count("nobody-uses-it") == 2
        assert "nobody-uses-it" not in lied.output.splitlines()
    finally:
        os.close(lock)
    assert isinstance(asked.exception, UsageError)
    assert asked.exception.advice == "run it with -y"
    again = CliRunner().invoke(hpcapp, ["adopt", "-y", str(file)], standalone_mode=False)
    assert again.exception is None
    assert "job" not in again.output


def test_a_host_that_is_silent_is_named_and_the_others_are_served(
    file: Path, hosts: tuple[Server, Server], machines: Machines
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    (file.parent / "cloud.ply").write_bytes(b"ply")

    def said_by(verb: str, *words: str) -> Result:
        return CliRunner().invoke(hpcapp, [verb, str(file), *words])

    machines.stop(hosts[1])
    for words in (["exec", "--all", "echo here"], ["exec", "--node", "worker-1", "true"],
                  ["put", str(file.parent / "cloud.ply"), "--all"]):  # fmt: skip
        done = said_by(*words)
        assert done.exit_code == 4, done.output
        [told] = [line for line in done.stderr.splitlines() if line.startswith("worker-1")]
        assert "cannot be looked at: unreachable: connection refused" in told
        assert (done.stdout == "head: here\n") == ("--all" in words and "exec" in words)
    assert (hosts[0].home / "cloud.ply").exists()
    table = said_by("status", "--offline").output.splitlines()
    assert table[0] == "cluster lab (ssh): up, worker-1 cannot be looked at"
    machines.stop(hosts[0])
    for words in (["exec", "true"], ["put", str(file)], ["get", "x"], ["logs"], ["jobs"], ["ssh"]):
        failed = CliRunner().invoke(
            hpcapp, [words[0], str(file), *words[1:]], standalone_mode=False
        )
        said = str(failed.exception) + failed.output
        assert "head (127.0.0" in said, words
        assert "is not up" not in said
        assert "hpcapp up" not in said
    table = said_by("status", "--offline").output.splitlines()
    assert (
        table[0]
        == "cluster lab (ssh): not known whether it is up, head, worker-1 cannot be looked at"
    )


def test_a_file_that_cannot_be_put_somewhere_goes_to_the_others(
    file: Path, hosts: tuple[Server, Server]
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    (file.parent / "cloud.ply").write_bytes(b"ply")
    (hosts[0].home / "cloud.ply").mkdir()
    done = CliRunner().invoke(hpcapp, ["put", str(file), str(file.parent / "cloud.ply"), "--all"])
    assert done.exit_code == 4
    assert "head" in done.stderr
    assert (hosts[1].home / "cloud.ply").read_bytes() == b"ply"


def test_down_of_a_cluster_that_was_never_made_says_what_is_known(
    file: Path, hosts: tuple[Server, Server], machines: Machines, tmp_path: Path
) -> None:
    said: list[str] = []
    for host in hosts:
        machines.stop(host)
    with open_cluster(file) as cluster, pytest.raises(LeftoverError) as caught:
        take_down(cluster, said.append, polling=Polling(poll_s=0.01))
    problem, advice = caught.value.problem, caught.value.advice
    assert problem.startswith("not known whether anything is left on head 127.0.0.")
    assert problem.count("unreachable: connection refused") == 2
    assert advice == "run the command again when they answer, or remove ~/hpcapp/lab there"
    assert said == []
    for host in hosts:
        machines.start(host, host.port)
    with open_cluster(file) as cluster:
        take_down(cluster, said.append, polling=Polling(poll_s=0.01))
    assert said == []


def test_without_a_key_no_host_is_said_to_have_refused_one(
    file: Path, hosts: tuple[Server, Server], tmp_path: Path
) -> None:
    (tmp_path / "user/.ssh/id_rsa").unlink()
    for words in (["down", "-y"], ["plan"], ["up", "-y"], ["status"], ["exec", "true"], ["jobs"]):
        failed = CliRunner().invoke(
            hpcapp, [words[0], str(file), *words[1:]], standalone_mode=False
        )
        assert isinstance(failed.exception, CloudError), words
        said = str(failed.exception) + failed.output
        assert "no key to log in with: there is none in ~/.ssh, and none in an agent" in said
        assert "refuses" not in said
        assert "may cost" not in said


def test_a_host_that_the_file_does_not_name_any_more_is_not_forgotten(
    file: Path, hosts: tuple[Server, Server], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hpcdeploy.install.bootstrap.set_up", lambda *about: {})
    whole = file.read_text()
    with open_cluster(file) as cluster:
        bring_up(cluster, print)
    spec = json.loads(whole)
    spec["provider"]["hosts"] = spec["provider"]["hosts"][:1]
    file.write_text(json.dumps(spec))
    there = f"cluster lab was made in the home of admin@{hosts[1].address}:{hosts[1].port}, where"
    for verb in ("plan", "status"):
        assert there in CliRunner().invoke(hpcapp, [verb, str(file)]).output
    with open_cluster(file) as cluster, pytest.raises(LeftoverError, match=re.escape(there)):
        take_down(cluster, print)
    assert (hosts[1].home / FOLDER).exists()
    file.write_text(whole)
    with open_cluster(file) as cluster:
        take_down(cluster, print)
    assert not (hosts[1].home / FOLDER).exists()
    assert there not in CliRunner().invoke(hpcapp, ["plan", str(file)]).output


def test_a_host_that_scale_has_let_go_is_not_said_to_hold_anything(
    file: Path, hosts: tuple[Server, Server], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hpcdeploy.install.bootstrap.set_up", lambda *about: {})
    with open_cluster(file) as cluster:
        bring_up(cluster, print)
        bring_up(replace(cluster, spec=cluster.spec.scaled(0)), print)
    spec = json.loads(file.read_text())
    spec["provider"]["hosts"] = spec["provider"]["hosts"][:1]
    file.write_text(json.dumps(spec))
    assert "was made in" not in CliRunner().invoke(hpcapp, ["plan", str(file)]).output
    with open_cluster(file) as cluster:
        take_down(cluster, print)
