"""What `validate` and `plan` print, and how they leave."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from simulated import FILE, SetUp, make_cluster
from simulated.memory import MemoryProvider

from hpcapp.cli import main
from hpccomponent.errors import CloudError
from hpcdeploy.provider import Problem
from hpcdeploy.reconcile.cluster import Cluster
from hpcdeploy.spec.cluster import read_spec
from hpcdeploy.spec.polling import Polling


def run(*arguments: str | Path) -> int:
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    assert isinstance(left.value.code, int)
    return left.value.code


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "cluster.yaml"
    path.write_text(FILE.format(cluster="bunny", market="on_demand", count=2, least=2))
    return path


@pytest.fixture
def cloud(monkeypatch: pytest.MonkeyPatch) -> MemoryProvider:
    """Put a cloud in memory, and a complete wheelhouse, where the verbs look for theirs."""
    provider = MemoryProvider()

    @contextmanager
    def opened(path: Path) -> Iterator[Cluster]:
        yield make_cluster(read_spec(path), provider)

    monkeypatch.setattr("hpcdeploy.reconcile.cluster.open_cluster", opened)
    monkeypatch.setattr("hpcdeploy.install.wheels.requirements.check_wheels", lambda spec, base: [])
    return provider


def test_a_valid_file_is_said_to_be(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("validate", file) == 0
    assert capsys.readouterr().out == f"{file}: valid: cluster bunny, aws, a head and 2 workers\n"


def test_mistakes_are_one_a_line_and_exit_code_2(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file.write_text(file.read_text().replace("lease", "laese").replace("{profile: small}", "{}"))
    assert run("validate", file) == 2
    told = capsys.readouterr()
    assert told.out == ""
    lines = told.err.splitlines()
    assert len(lines) == 2
    assert all(line.startswith(f"hpcapp: {file}:") for line in lines)
    assert "head.profile: missing key" in lines[0]
    assert lines[1].endswith("limits.laese: unknown key (got '2h'), did you mean \"lease\"?")


def test_a_plan_says_what_would_be_made_and_what_it_costs(
    file: Path, cloud: MemoryProvider, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("plan", file) == 0
    told = capsys.readouterr().out
    for part in ("would create the security group", "would create the key pair",
                 "would launch head as m6i.large", "would launch worker-2",
                 "cost: head: 1 x m6i.large, $0.10", "cost: together $0.45"):  # fmt: skip
        assert part in told
    assert not cloud.observe(None).lives
    assert run("plan", file, "--json") == 0
    kinds = [action["kind"] for action in json.loads(capsys.readouterr().out)["actions"]]
    assert kinds == ["CreateGroup", "Allow", "CreateKeyPair", *["LaunchNode"] * 3]


def test_of_a_cluster_that_is_up_there_is_nothing_to_change(
    file: Path,
    cloud: MemoryProvider,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    from hpcdeploy.reconcile.converge import bring_up

    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("hpcdeploy.install.bootstrap.set_up", SetUp())
    monkeypatch.setattr("hpcdeploy.install.user_data.user_data", lambda *given: "#!/bin/sh")
    bring_up(make_cluster(read_spec(file), cloud), lambda line: None, polling=Polling())
    assert run("plan", file, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["cluster"], told["actions"], told["missing"]) == ("bunny", [], [])
    assert told["cost"]["hourly"] == pytest.approx(0.455, abs=0.01)
    assert told["cost"]["total_at_most"] == pytest.approx(2 * told["cost"]["hourly"])
    assert told["cost"]["is_estimate"]


def test_what_is_missing_is_said(
    file: Path,
    cloud: MemoryProvider,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    missing = [Problem("no wheel of numpy for cp312", "add it to wheels/")]
    monkeypatch.setattr(
        "hpcdeploy.install.wheels.requirements.check_wheels", lambda spec, base: missing
    )
    assert run("plan", file) == 0
    assert "missing: no wheel of numpy for cp312; add it to wheels/\n" in capsys.readouterr().out


def test_a_plan_beyond_the_limits_is_shown_and_refused(
    file: Path, cloud: MemoryProvider, capsys: pytest.CaptureFixture[str]
) -> None:
    file.write_text(file.read_text().replace("{lease: 2h", "{max_hourly_cost: 0.10, lease: 2h"))
    assert run("plan", file) == 2
    told = capsys.readouterr()
    assert "would launch head" in told.out
    assert "more than limits.max_hourly_cost, $0.10" in told.err


def test_what_a_machine_has_said_stands_in_a_block_of_its_own(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> Cluster:
        console = "Kernel panic - not syncing\n\n\x1b[2JVFS: no root"
        raise CloudError("head (i-1): no answer", "see the image; its console ends so", console)

    monkeypatch.setattr("hpcdeploy.reconcile.cluster.open_cluster", refuse)
    assert run("plan", file) == 4
    assert capsys.readouterr().err.splitlines() == [
        "hpcapp: head (i-1): no answer; see the image; its console ends so",
        "    Kernel panic - not syncing",
        r"    \x1b[2JVFS: no root",
    ]
