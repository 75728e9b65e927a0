"""The verbs up, down, scale, status, ls and reap, as they are typed, on a cloud in memory."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from simulated import FILE, START, key_pairs_of, stub_set_up
from simulated.memory import MemoryProvider

from hpcapp.cli import hpcapp
from hpccomponent.cli.terminal import write_block
from hpccomponent.cli.verbosity import Verbosity, set_verbosity
from hpccomponent.errors import CloudError, LeftoverError, OutdatedError, UsageError
from hpcdeploy.cli.asking import say
from hpcdeploy.provider import Launch, Observed, State, Tags
from hpcdeploy.spec.names import NOBODY, NodeName, Owner
from hpcdeploy.spec.polling import utc_now


@pytest.fixture
def cloud(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[MemoryProvider]:
    cloud = MemoryProvider(utc_now)
    stub_set_up(monkeypatch, tmp_path)
    monkeypatch.setattr("hpcdeploy.login.access.Access.open", lambda *about: ExitStack())
    for module in ("hpcdeploy.providers", "hpcdeploy.providers.clouds"):
        monkeypatch.setattr(f"{module}.open_provider", lambda spec, base: cloud)
    yield cloud
    set_verbosity(Verbosity.NORMAL)


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "cluster.yaml"
    path.write_text(FILE.format(cluster="bunny", count=2, least=2, market="on_demand"))
    return str(path)


def run(*arguments: str, typed: str | None = None) -> Result:
    return CliRunner().invoke(hpcapp, arguments, input=typed, standalone_mode=False)


def alive(cloud: MemoryProvider) -> list[str]:
    machines = cloud.observe(None).machines
    return sorted(m.name.node for m in machines if m.state is State.RUNNING)


def test_up_shows_what_it_will_do_and_asks(cloud: MemoryProvider, file: str) -> None:
    refused = run("up", file, typed="n\n")
    assert "will launch head as m6i.large (on_demand)" in refused.output
    assert "cost: " in refused.output
    assert alive(cloud) == []
    agreed = run("up", file, typed="y\n")
    assert "cluster bunny is up: 3 machines" in agreed.output
    assert alive(cloud) == ["head", "worker-1", "worker-2"]


def test_a_quiet_up_says_nothing_and_asks_nothing(cloud: MemoryProvider, file: str) -> None:
    refused = run("-q", "up", file, typed="y\n")
    assert isinstance(refused.exception, UsageError)
    assert refused.exception.advice == "run it with -y"
    assert alive(cloud) == []
    for verb in ("up", "down"):
        done = run(verb, file, "-y", "-q")
        assert (done.exception, done.output) == (None, "")


def test_up_launches_nothing_where_wheels_are_missing(cloud: MemoryProvider, file: str) -> None:
    wheels = Path(file).with_name("wheels")
    wheels.mkdir()
    text = Path(file).read_text() + "env: {wheelhouse: wheels}\n"
    Path(file).write_text(text)
    refused = run("up", "-y", file)
    assert isinstance(refused.exception, CloudError)
    assert "nothing is launched: " in str(refused.exception)
    assert "no compiled wheel for Linux in it" in str(refused.exception)
    assert "missing: " in refused.output
    assert cloud.observe(None).lives == ()
    run("up", "-y", "--skip-checks", file)
    assert alive(cloud) == ["head", "worker-1", "worker-2"]


def test_up_without_a_terminal_says_how_to_go_on(cloud: MemoryProvider, file: str) -> None:
    for typed in ("", "n\n"):
        refused = run("up", file, typed=typed)
        assert isinstance(refused.exception, UsageError)
        assert refused.exception.advice == "run it with -y"
    assert alive(cloud) == []


def test_a_line_is_one_line_but_for_a_block_of_somebody_elses_words(
    capsys: pytest.CaptureFixture[str],
) -> None:
    block = write_block("one\ntwo")
    say(f"worker-1: its console ends so:\n{block}")
    say("worker-1 (gone)\ncluster bunny: nobody uses it\r")
    assert capsys.readouterr().err == (
        "worker-1: its console ends so:\n    one\n    two\n"
        "worker-1 (gone)\\ncluster bunny: nobody uses it\\x0d\n"
    )


class Meanwhile:
    """Lets something happen to the cloud right before it is looked at for the n-th time."""

    def __init__(self, cloud: MemoryProvider, look: int, act: Callable[[], object]) -> None:
        self.left, self.act = look, act
        cloud.hook = self

    def __call__(self, moment: str, call: str) -> None:
        if (moment, call) == ("before", "observe"):
            self.left -= 1
            if self.left == 0:
                self.act()


def test_up_asks_again_where_it_would_do_more_than_was_agreed_to(
    cloud: MemoryProvider, file: str
) -> None:
    """A worker vanishes while the question stands there: it was not said that it is launched."""
    run("up", "-y", file)
    Path(file).write_text(Path(file).read_text().replace("count: 2", "count: 3"))
    Meanwhile(cloud, 2, lambda: cloud.interrupt("worker-1"))
    refused = run("up", file, typed="y\nn\n")
    assert isinstance(refused.exception, UsageError)
    said = refused.output.splitlines()
    assert "will launch worker-1 as c6i.xlarge or c6a.xlarge (on_demand), generation 2" in said
    assert any("has changed meanwhile: launch worker-1" in line for line in said)
    assert alive(cloud) == ["head", "worker-2"]
    agreed = run("up", file, typed="y\n")
    assert agreed.exception is None
    assert agreed.output.count("Go on?") == 1
    assert alive(cloud) == ["head", "worker-1", "worker-2", "worker-3"]


def test_up_asks_where_nothing_was_to_be_done_and_something_is_by_now(
    cloud: MemoryProvider, file: str
) -> None:
    run("up", "-y", file)
    Meanwhile(cloud, 2, lambda: cloud.interrupt("worker-1"))
    refused = run("up", file, typed="n\n")
    assert isinstance(refused.exception, UsageError)
    assert alive(cloud) == ["head", "worker-2"]


def test_up_does_not_ask_again_for_less_than_was_agreed_to(
    cloud: MemoryProvider, file: str
) -> None:
    run("up", "-y", file)
    Path(file).write_text(FILE.format(cluster="bunny", count=0, least=0, market="on_demand"))
    Meanwhile(cloud, 2, lambda: cloud.interrupt("worker-1"))
    agreed = run("up", file, typed="y\n")
    assert agreed.output.count("Go on?") == 1
    assert alive(cloud) == ["head"]


def test_scale_asks_again_too(cloud: MemoryProvider, file: str) -> None:
    run("up", "-y", file)
    Meanwhile(cloud, 2, lambda: cloud.interrupt("worker-1"))
    refused = run("scale", file, "1", typed="y\nn\n")
    assert isinstance(refused.exception, UsageError)
    assert alive(cloud) == ["head", "worker-2"]


def make_foreign(cloud: MemoryProvider, user: str, life: str) -> Callable[[], object]:
    """Return what makes a cluster of the file's name that is another's."""

    def make() -> None:
        owner = Owner(user, f"SHA256:{user}")
        cloud.create_group("bunny", life, owner)
        cloud.launch(Launch("bunny", life, NodeName("head"), owner=owner))

    return make


def change_hands(cloud: MemoryProvider, user: str) -> Callable[[], object]:
    """Return what makes another the owner of the cluster that there is."""

    def change() -> None:
        seen = cloud.observe("bunny")
        running = [machine for machine in seen.machines if machine.state is State.RUNNING]
        cloud.tag(running, Tags(Owner(user, f"SHA256:{user}")), seen.lives)

    return change


def test_down_takes_away_only_the_cluster_that_was_named(cloud: MemoryProvider, file: str) -> None:
    """Anna's cluster is named; when it comes to it, her name is Ben's."""
    make_foreign(cloud, "anna@lab", "first")()
    Meanwhile(cloud, 2, change_hands(cloud, "ben@lab"))
    refused = run("down", file, typed="bunny\n")
    assert isinstance(refused.exception, UsageError)
    assert refused.exception.advice == "give --name bunny to take it away"
    assert "has changed meanwhile" in refused.output
    assert "by ben@lab" in refused.output
    assert alive(cloud) == ["head"]
    run("down", file, typed="bunny\n")
    assert alive(cloud) == []


@pytest.mark.parametrize("options", [(), ("-y",)])
def test_down_by_name_takes_nothing_else_that_has_come_meanwhile(
    cloud: MemoryProvider, file: str, options: tuple[str, ...]
) -> None:
    make_foreign(cloud, "anna@lab", "first")()
    Meanwhile(cloud, 2, change_hands(cloud, "ben@lab"))
    refused = run("down", *options, "--name", "bunny", file)
    assert isinstance(refused.exception, OutdatedError)
    assert refused.exception.advice == "run the command again"
    assert alive(cloud) == ["head"]
    assert run("down", *options, "--name", "bunny", file).exception is None
    assert alive(cloud) == []


def test_adopt_unasked_takes_over_nothing_else_that_has_come_meanwhile(
    cloud: MemoryProvider, file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloud.create_group("bunny", "first", Owner("anna@lab", "SHA256:anna@lab"))
    monkeypatch.setattr(  # no machine is there to log in to
        "hpcdeploy.reconcile.adoption.check_way_in",
        lambda cluster, key: (cluster.provider.observe("bunny"), {}),
    )
    Meanwhile(cloud, 2, change_hands(cloud, "ben@lab"))
    assert isinstance(run("adopt", "-y", file).exception, OutdatedError)
    assert [group.owner.user for group in cloud.observe("bunny").lives] == ["ben@lab"]


def test_up_again_asks_nothing_where_nothing_is_to_be_done(
    cloud: MemoryProvider, file: str
) -> None:
    run("up", "-y", file)
    again = run("up", file)
    assert again.exception is None
    assert "Go on?" not in again.output


def test_a_file_that_was_changed_while_its_cluster_lives_is_told_of(
    cloud: MemoryProvider, file: str
) -> None:
    run("up", "-y", file)
    text = Path(file).read_text().replace("m6i.large", "m7i.large").replace("2h}", "2h, idle: 5m}")
    Path(file).write_text(text)
    planned = run("plan", file)
    assert "nothing to create or change" in planned.output
    machines = {m.name.node: m.id for m in cloud.observe("bunny").machines}
    for said in (planned.output, run("up", file).output):
        lines = said.splitlines()
        head = f"drift: head ({machines['head']}): instance_type is m6i.large, not m7i.large, "
        assert f"{head}limits.idle is 900, not 300" in lines
        assert any(line.startswith("drift: worker-1") for line in lines)
        assert any(f"hpcapp down {file} and then hpcapp up {file}" in line for line in lines)
    assert len(json.loads(run("plan", "--json", file).stdout)["drift"]) == 3
    run("down", file)
    assert "drift" not in run("plan", file).output


@pytest.mark.parametrize(
    "other",
    [
        "{type: aws, region: eu-west-1, profiles: {a: {image: {id: ami-1}, instance_type: m}}}",
        "{type: local}",
        "{type: ssh, hosts: [{address: lab1}, {address: lab2}, {address: lab3}]}",
    ],
)
def test_a_file_that_leads_elsewhere_says_where_its_cluster_lives(
    cloud: MemoryProvider, file: str, other: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run("up", "-y", file)
    there = "cluster bunny was made in aws us-east-1"
    made = Path(file).read_text()
    text = f"version: 1\ncluster: bunny\nworkers: {{count: 2}}\nprovider: {other}\n"
    networks = "auth: {allow_from: [192.0.2.0/24]}\n" if "aws" in other else ""
    Path(file).write_text(text + networks)
    elsewhere = MemoryProvider(utc_now)
    elsewhere.makes_machines = "aws" in other
    monkeypatch.setattr("hpcdeploy.providers.open_provider", lambda spec, base: elsewhere)
    monkeypatch.setattr("hpcdeploy.install.wheels.requirements.check_wheels", lambda spec, base: [])
    assert there in run("plan", file).output
    assert there in json.loads(run("plan", "--json", file).stdout)["elsewhere"]
    assert there in run("up", file, typed="n\n").output
    for _ in range(2):
        refused = run("down", "-y", file)
        assert isinstance(refused.exception, LeftoverError)
        assert there in str(refused.exception)
        assert " in ," not in str(refused.exception)
        assert f"hpcapp down {file}" in str(refused.exception)

    def refuse(cluster: str | None) -> Observed:
        raise CloudError("no network", "plug it in")

    monkeypatch.setattr(elsewhere, "observe", refuse)
    for verb in ("plan", "up", "down", "status"):
        assert there in run(verb, file).output
    assert alive(cloud) == ["head", "worker-1", "worker-2"]
    Path(file).write_text(made)
    monkeypatch.setattr("hpcdeploy.providers.open_provider", lambda spec, base: cloud)
    assert run("down", "-y", file).exception is None
    assert alive(cloud) == []


def test_scale_leaves_the_file_and_says_so(cloud: MemoryProvider, file: str) -> None:
    run("up", "-y", file)
    result = run("scale", "-y", file, "1")
    assert alive(cloud) == ["head", "worker-1"]
    assert "the next hpcapp up goes back to 2: see workers.count" in result.output


def test_down_says_that_nothing_is_left(cloud: MemoryProvider, file: str) -> None:
    run("up", "-y", file)
    result = run("down", file)
    assert result.output.splitlines()[-1] == "cluster bunny: nothing is left"
    assert alive(cloud) == []
    assert cloud.observe(None).lives == ()


def test_ls_lists_the_clouds_that_answer_and_names_the_others(
    cloud: MemoryProvider, file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run("up", "-y", file)
    silent = Path(file).with_name("silent.yaml")
    silent.write_text(Path(file).read_text().replace("type: aws", "type: aws\n  region: eu-west-1"))
    other = MemoryProvider(utc_now)

    def refuse(cluster: str | None) -> Observed:
        raise CloudError("no network", "plug it in")

    monkeypatch.setattr(other, "observe", refuse)
    monkeypatch.setattr(
        "hpcdeploy.providers.clouds.open_provider",
        lambda spec, base: other if spec.provider.region == "eu-west-1" else cloud,
    )
    result = run("ls", "--all", str(silent), file)
    assert "bunny" in result.stdout
    assert str(result.exception) == "no network; plug it in"
    alone = run("ls", "--all", str(silent))
    assert (alone.stdout, type(alone.exception)) == ("", CloudError)


def test_status_for_programs(cloud: MemoryProvider, file: str) -> None:
    run("up", "-y", file)
    found = json.loads(run("status", "--json", "--offline", file).stdout)
    assert [machine["node"] for machine in found["machines"]] == ["head", "worker-1", "worker-2"]


def test_ls_lists_the_files_clusters_or_all(cloud: MemoryProvider, file: str) -> None:
    run("up", "-y", file)
    cloud.create_group("other", "life", NOBODY)
    assert [row["cluster"] for row in json.loads(run("ls", "--json", file).stdout)] == ["bunny"]
    rows = json.loads(run("ls", "--all", "--json").stdout)
    assert [row["cluster"] for row in rows] == ["bunny", "other"]
    assert isinstance(run("ls").exception, UsageError)


def test_reap_says_first_and_does_then(cloud: MemoryProvider, file: str) -> None:
    run("up", "-y", file)
    lease_until = START.replace(year=2020)
    old = cloud.launch(Launch("old", "life", NodeName("head"), lease_until=lease_until))
    cloud.create_group("old", "life", NOBODY)
    cloud.create_key_pair("older", "life", "k")
    dry = run("reap", "--dry-run", file)
    found = f"head {old.id} (running), security group hpcapp-old, key pair hpcapp-older-life"
    assert f"would remove {found}" in dry.output
    assert run("reap", "--dry-run", file).output == dry.output
    run("reap", file)
    left = cloud.observe(None)
    assert {m.cluster for m in left.machines if m.state is State.RUNNING} == {"bunny"}
    assert [pair.cluster for pair in key_pairs_of(left)] == ["bunny"]
    assert "nothing to remove" in run("reap", "--dry-run").output
