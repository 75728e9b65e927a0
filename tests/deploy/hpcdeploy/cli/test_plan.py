"""What `validate` and `plan` print, and how they leave."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from cloud import StrictCloud
from simulated import FILE, make_cluster, stub_set_up
from simulated.memory import MemoryProvider
from typed import run

from hpccomponent.errors import CloudError
from hpcdeploy.provider import Problem
from hpcdeploy.reconcile.cluster import Cluster
from hpcdeploy.spec.cluster import read_spec
from hpcdeploy.spec.polling import Polling


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
    assert lines[1].endswith('limits.laese: unknown key, did you mean "lease"?')


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("m6i.large", "m6i.lagre", "provider.profiles.small.instance_type: m6i.lagre is not in the "
         "price list of 2025-06; m6i.large is"),
        ("type: aws", "type: aws\n  region: us-eats-1",
         "provider.region: us-eats-1 is not in the price list of 2025-06; us-east-1 is"),
        ("[192.0.2.0/24]", "[192.0.2.7, 0.0.0.0/0]",
         "auth.allow_from[1]: 0.0.0.0/0 opens SSH to everybody"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("verb", [["validate"], ["plan", "--offline"]])
def test_what_is_hardly_meant_is_warned_of(
    file: Path,
    cloud: MemoryProvider,
    capsys: pytest.CaptureFixture[str],
    verb: list[str],
    old: str,
    new: str,
    told: str,
) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    assert run(verb[0], file, *verb[1:]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"warning: {file}: {told}")


def test_a_file_that_is_not_there_can_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for verb in ("validate", "plan", "up"):
        assert run(verb, tmp_path / "none.yaml") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.endswith(f"no such cluster file; write one: hpcapp init {tmp_path}/none.yaml")


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

    stub_set_up(monkeypatch, tmp_path)
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


def test_offline_a_plan_asks_nobody_and_says_where_its_prices_come_from(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("socket.socket.connect", lambda *given: pytest.fail("a network was asked"))
    monkeypatch.setattr("socket.getaddrinfo", lambda *given, **more: pytest.fail("a name was"))
    file.write_text(file.read_text().replace("{lease: 2h", "{max_hourly_cost: 0.5, lease: 2h"))
    assert run("plan", "--offline", file) == 0
    told = capsys.readouterr().out
    assert told.startswith("offline: nothing was looked up; from nothing ")
    for part in ("would launch head as m6i.large", "would launch worker-2", "together $0.45",
                 "prices: Amazon's list of 2025-06", "an hour keeps max_hourly_cost, $0.50",
                 "15 min idle end it before, and cost $0.11"):  # fmt: skip
        assert part in told
    assert run("plan", "--offline", file, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert not report["is_looked_up"]
    assert [action["kind"] for action in report["actions"]] == ["LaunchNode"] * 3
    assert report["cost"]["total_at_most"] == pytest.approx(2 * report["cost"]["hourly"])
    assert report["cost"]["priced_by"][0].startswith("Amazon's list of 2025-06")


def test_offline_what_the_limits_forbid_is_refused_too(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file.write_text(file.read_text().replace("{lease: 2h", "{max_total_cost: 0.8, lease: 2h"))
    assert run("plan", "--offline", file) == 2
    told = capsys.readouterr()
    assert "breaks max_total_cost, $0.8000" in told.out
    assert "more than limits.max_total_cost, $0.8000" in told.err


def test_without_keys_the_plan_of_the_file_is_shown_before_it_is_refused(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_PROFILE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "none"))
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "none"))
    assert run("plan", file) == 4
    told = capsys.readouterr()
    assert told.out.startswith("nothing could be looked up, see below; from nothing ")
    assert "cost: together $0.45" in told.out
    [error] = told.err.splitlines()
    assert "no keys" in error
    assert run("plan", file, "--json") == 4
    assert json.loads(capsys.readouterr().out)["is_looked_up"] is False


EXAMPLES = sorted((Path(__file__).parents[4] / "deploy/hpcdeploy/examples").glob("*.yaml"))
PRICES = {
    "aws": "cost: together $0.63",
    "ec2": "cost: together $0.7200 an hour",
    "eucalyptus": "cost: none, by default: a Eucalyptus bills nobody",
    "paper-table-1": "cost: none, by default: a Eucalyptus bills nobody",
    "ssh": "the machines are there anyway",
    "local": "the machines are there anyway",
}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_each_example_has_a_price_or_says_why_not(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("plan", "--offline", path) == 0
    assert PRICES[path.stem] in capsys.readouterr().out


def test_what_a_plan_says_offline_it_says_of_an_empty_cloud_too(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    file = tmp_path / "cluster.yaml"

    def launches(*options: str) -> tuple[int, list[object], object]:
        code = run("plan", file, "--json", *options)
        told = json.loads(capsys.readouterr().out)
        nodes = [action for action in told["actions"] if action["kind"] == "LaunchNode"]
        return code, nodes, told["cost"]

    with StrictCloud("aws") as cloud:
        for name, value in cloud.environment().items():
            monkeypatch.setenv(name, value)
        block = cloud.provider_block()
        file.write_text(json.dumps({"version": 1, "cluster": "bunny", "provider": block}))
        there = launches()
        assert cloud.calls
        cloud.calls.clear()
        offline = launches("--offline")
        assert not cloud.calls
    assert there == offline
    assert (there[0], len(there[1])) == (0, 2)
    assert run("plan", file) == 4  # the cloud is gone
    told = capsys.readouterr()
    assert told.out == ""
    assert len(told.err.splitlines()) == 1
