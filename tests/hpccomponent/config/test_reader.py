"""Every mistake in a YAML file is named at its line and column, all of them at once."""

from __future__ import annotations

import os
import re
from enum import Enum
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, field_validator

from hpccomponent.config.reader import ConfigModel, Misfit, parse_config, read_config
from hpccomponent.errors import ConfigError


class Policy(Enum):
    EQUAL = "equal"
    PULL = "pull"


class Aws(ConfigModel):
    kind: Literal["aws"]
    region: str = "eu-west-1"
    instance_type: str = "c5.xlarge"


class Ssh(ConfigModel):
    kind: Literal["ssh"]
    hosts: list[str]


class Restart(ConfigModel):
    first_s: float = 1.0
    cap_s: float = Field(default=60.0, gt=0)


class Cluster(ConfigModel):
    name: str = "c"
    workers: int = 1
    policy: Policy = Policy.PULL
    mode: Literal["fast", "exact"] = "fast"
    folder: Path | None = None
    sizes: tuple[int, ...] = ()
    limit: int | bool | None = None
    provider: Annotated[Aws | Ssh, Field(discriminator="kind")] | None = None
    restarts: list[Restart] = Field(default=[])
    by_host: dict[str, Restart] = Field(default={})

    @field_validator("name")
    @classmethod
    def _lower(cls, name: str) -> str:
        if name != name.lower():
            raise ValueError("must be in lower case")
        return name


def complaint(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "c.yaml", Cluster)
    assert caught.value.exit_code == 2
    return str(caught.value)


def test_a_right_file_becomes_the_model() -> None:
    text = """
        name: bunny
        workers: 4
        policy: equal
        folder: /tmp/x
        sizes: [1, 2]
        limit: true
        provider: {kind: ssh, hosts: [a, b]}
        restarts: [{first_s: 2}]
        by_host: {alpha: {cap_s: 3.5}}
    """
    cluster = parse_config(text, "c.yaml", Cluster)
    assert cluster == Cluster(
        name="bunny",
        workers=4,
        policy=Policy.EQUAL,
        folder=Path("/tmp/x"),  # noqa: S108 - a value, no file
        sizes=(1, 2),
        limit=True,
        provider=Ssh(kind="ssh", hosts=["a", "b"]),
        restarts=[Restart(first_s=2)],
        by_host={"alpha": Restart(cap_s=3.5)},
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wrokers: 2", 'c.yaml:1:1: wrokers: unknown key, did you mean "workers"?'),
        (
            "restarts:\n- {}\n- first_s: 1\n  capp_s: 2",
            'c.yaml:4:3: restarts[1].capp_s: unknown key, did you mean "cap_s"?',
        ),
        (
            "by_host:\n  alpha: {frist_s: 2}",
            'c.yaml:2:11: by_host.alpha.frist_s: unknown key, did you mean "first_s"?',
        ),
        (
            "provider:\n  kind: aws\n  instance_typ: c5.large",
            'c.yaml:3:3: provider.instance_typ: unknown key, did you mean "instance_type"?',
        ),
        (
            "provider: {kind: awss}",
            "c.yaml:1:12: provider.kind: unknown value (got 'awss'), did you mean \"aws\"?",
        ),
        (
            "provider: {kind: gcp}",
            "c.yaml:1:12: provider.kind: unknown value (got 'gcp'), valid here: aws, ssh",
        ),
        ("provider: {kind: ssh}", "c.yaml:1:1: provider.hosts: missing key"),
        ("provider: {hosts: [a]}", "c.yaml:1:1: provider.kind: missing key"),
        (
            "policy: pul",
            "c.yaml:1:1: policy: should be 'equal' or 'pull' (got 'pul'), did you mean \"pull\"?",
        ),
        (
            "mode: fsat",
            "c.yaml:1:1: mode: should be 'fast' or 'exact' (got 'fsat'), did you mean \"fast\"?",
        ),
        ("workers: '4'", "c.yaml:1:1: workers: should be a valid integer (got '4')"),
        ("workers: four", "c.yaml:1:1: workers: should be a valid integer (got 'four')"),
        ("workers:", "c.yaml:1:1: workers: should be a valid integer (got nothing)"),
        ("name: no", "c.yaml:1:1: name: should be a valid string (got no)"),
        ("name: Bunny", "c.yaml:1:1: name: must be in lower case (got 'Bunny')"),
        (
            "limit: x",
            "c.yaml:1:1: limit: should be a valid integer (got 'x'), "
            "or should be a valid boolean (got 'x')",
        ),
        ("sizes: 3", "c.yaml:1:1: sizes: should be a list (got 3)"),
        ("sizes: [1, x]", "c.yaml:1:12: sizes[1]: should be a valid integer (got 'x')"),
        (
            "restarts: [3]",
            "c.yaml:1:12: restarts[0]: should be a mapping of keys to values (got 3)",
        ),
        ("by_host: []", "c.yaml:1:1: by_host: should be a mapping of keys to values (got a list)"),
    ],
)
def test_a_wrong_value_or_key_is_named(text: str, message: str) -> None:
    assert complaint(text) == message


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "c.yaml: the file is empty"),
        ("# only a comment\n", "c.yaml: the file is empty"),
        ("- 1\n- 2", "c.yaml:1:1: should be a mapping of keys to values (got a list)"),
        ("\n  just text", "c.yaml:2:3: should be a mapping of keys to values (got 'just text')"),
        ("name: a\n\tworkers: 2", "c.yaml:2:1: a tab where YAML wants spaces"),
        ("name: [a", "c.yaml:1:9: not YAML: expected"),
        ("name: 'a", "c.yaml:1:9: not YAML: found unexpected end of stream"),
        ("name: a\nname: b", "c.yaml:2:1: name: key given twice, first in line 1"),
        ("name: a\n---\nname: b", "c.yaml:2:1: not YAML: but found another document"),
        ("1: a", "c.yaml:1:1: a key must be text (got 1), quote it"),
        ("on: a", "c.yaml:1:1: a key must be text (got on), quote it"),
        ("[a, b]: c", "c.yaml:1:1: a key must be text (got a list), quote it"),
        (
            "by_host:\n  a: &a {}\n  b: {<<: x}",
            "c.yaml:3:7: by_host.b: a mapping has one merge key",
        ),
        ("by_host: {a: &a {}, b: {<<: *a, <<: *a}}", "c.yaml:1:33: by_host.b: a mapping has one"),
        ("by_host: {a: &a {}, b: {<<: [*a, 3]}}", "c.yaml:1:25: by_host.b: a mapping has one"),
        ("restarts: &a [*a]", "c.yaml:1:11: an alias that contains itself"),
        ("by_host: &a {b: {<<: *a}}", "c.yaml:1:10: an alias that contains itself"),
        ("name: !!python/name:os.system x", "c.yaml:1:7: name: not a value that"),
        ("workers: !!int x", "c.yaml:1:10: workers: not a value that 'int' can describe"),
        ("workers: !!int [1]", "c.yaml:1:10: workers: not a value that 'int' can describe"),
        ("name: a\nworkers: \x01", "c.yaml:2:10: not YAML: special characters are not allowed"),
        ("sizes: " + "[" * 5000, "c.yaml:1:57: nested more than 50 deep"),
        ("- " * 5000, "c.yaml:1:101: nested more than 50 deep"),
        ("sizes: [" + "1," * 60_000, "c.yaml:1:100003: more than 50000 values"),
        ("#" * 99 + "\n" + "# \n" * 90_000, "c.yaml:87350: here the file is longer than 256 KiB"),
    ],
)
def test_what_is_no_yaml_of_ours_is_named(text: str, part: str) -> None:
    assert any(line.startswith(part) for line in complaint(text).splitlines())


def test_all_mistakes_come_at_once_in_the_order_of_the_text() -> None:
    lines = complaint("wrokers: 2\nname: B\nrestarts:\n- {cap_s: 0}\nsizes: x").splitlines()
    assert [line.split(": ")[1] for line in lines] == [
        "wrokers",
        "name",
        "restarts[0].cap_s",
        "sizes",
    ]


def test_mistakes_of_yaml_and_of_the_model_come_together() -> None:
    text = "name: a\nname: b\nwrokers: 2\nlimit: !!int x\n1: 2"
    assert [line.split(": ")[1] for line in complaint(text).splitlines()] == [
        "name",
        "wrokers",
        "limit",
        "a key must be text (got 1), quote it",
    ]


def test_dates_are_text_and_long_values_are_cut() -> None:
    assert parse_config("name: 2026-01-02", "c", Cluster).name == "2026-01-02"
    assert len(complaint("workers: " + "x" * 500)) < 150


@given(st.text(alphabet=st.sampled_from("ab:[]{}-&*!<>|'\"#%?,\n\t 1\x00é~"), max_size=60))
def test_no_text_brings_the_reader_down(text: str) -> None:
    try:
        parse_config(text, "c.yaml", Cluster)
        complaints = []
    except ConfigError as error:
        complaints = str(error).splitlines()
    assert all(re.match(r"c\.yaml[: ]", line) for line in complaints)


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    (tmp_path / "latin.yaml").write_bytes(b"name: \xe9")
    for name, part in [
        ("none.yaml", "No such file"),
        (".", "Is a directory"),
        ("latin.yaml", "byte 6 is not UTF-8"),
    ]:
        with pytest.raises(ConfigError, match=part):
            read_config(tmp_path / name, Cluster)


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    (tmp_path / "bom.yaml").write_bytes(b"\xef\xbb\xbfname: a")
    assert read_config(tmp_path / "bom.yaml", Cluster).name == "a"


def few_workers(cluster: Cluster) -> list[Misfit]:
    """Say what a check of the whole may say: at a value, below a missing block, with choices."""
    found = []
    if cluster.workers > 2:
        found.append(Misfit(("workers",), "too many"))
    if cluster.limit is None:
        found.append(Misfit(("by_host", "alpha", "cap_s"), "needed without a limit"))
    if cluster.name not in ("alpha", "beta"):
        found.append(Misfit(("name",), "nobody's name", ("alpha", "beta")))
    return found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: beta\nworkers: 3\nlimit: 1", "c.yaml:2:1: workers: too many (got 3)"),
        (
            "limit: 1\nname: aplha",
            "c.yaml:2:1: name: nobody's name (got 'aplha'), did you mean \"alpha\"?",
        ),
        ("limit: 1\nname: z", "c.yaml:2:1: name: nobody's name (got 'z'), valid here: alpha, beta"),
        ("name: beta", "c.yaml:1:1: by_host.alpha.cap_s: needed without a limit"),
        (
            "name: beta\nby_host:\n  alpha: {}",
            "c.yaml:3:3: by_host.alpha.cap_s: needed without a limit",
        ),
    ],
)
def test_what_does_not_fit_together_is_placed(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "c.yaml", Cluster, few_workers)
    assert str(caught.value) == message


def test_what_does_not_fit_is_named_beside_what_is_wrong_by_itself() -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(
            "name: 7\nworkers: 3\nlimit: 1\nmod: fast\nmode: slow", "c.yaml", Cluster, few_workers
        )
    assert [line.split(": ")[1] for line in str(caught.value).splitlines()] == [
        "name",  # wrong by itself, so not checked against the others
        "workers",
        "mod",
        "mode",
    ]


def test_a_file_that_fits_together_becomes_the_model() -> None:
    text = "name: beta\nlimit: 1"
    assert parse_config(text, "c.yaml", Cluster, few_workers) == Cluster(name="beta", limit=1)


def test_anchors_and_merge_keys_are_those_of_yaml() -> None:
    """The mapping's own keys count before merged ones, and what is merged first before the rest."""
    text = """
        restarts: [&slow {first_s: 9, cap_s: 90}, &quick {first_s: 2}]
        by_host:
          alias: *slow
          merged: {<<: *slow}
          own: {first_s: 5, <<: *slow}
          own_last: {<<: *slow, first_s: 5}
          several: {<<: [*quick, *slow]}
          around: {<<: [*slow, *quick]}
          again: &again {<<: *quick, cap_s: 7}
          twice: {<<: *again, first_s: 3}
    """
    found = parse_config(text, "c.yaml", Cluster).by_host
    assert {name: (restart.first_s, restart.cap_s) for name, restart in found.items()} == {
        "alias": (9, 90),
        "merged": (9, 90),
        "own": (5, 90),
        "own_last": (5, 90),
        "several": (2, 90),
        "around": (9, 90),
        "again": (2, 7),
        "twice": (3, 7),
    }


def test_a_mistake_in_what_is_merged_is_named_where_it_stands() -> None:
    text = "by_host:\n  a: &a {capp_s: 1}\n  b: {<<: *a, first_s: 1, first_s: 2}"
    assert complaint(text).splitlines() == [
        'c.yaml:2:10: by_host.a.capp_s: unknown key, did you mean "cap_s"?',
        'c.yaml:2:10: by_host.b.capp_s: unknown key, did you mean "cap_s"?',
        "c.yaml:3:27: by_host.b.first_s: key given twice, first in line 3",
    ]


LAUGHS = "a: &0 [x,x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"b{i}: &{i} [{','.join([f'*{i - 1}'] * 10)}]\n" for i in range(1, 30)
)
CHAIN = "a: &0 [x]\n" + "".join(f"b{i}: &{i} [*{i - 1}]\n" for i in range(1, 5_000))
MERGES = (
    "a: &a\n" + "".join(f"  k{i}: x\n" for i in range(5_000)) + "b:\n" + "- {<<: *a}\n" * 10_000
)


@pytest.mark.slow
@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("text", "said"),
    [
        (LAUGHS, r"c\.yaml:5:5: aliases \(\*\) make this more than 50000 values; leave out"),
        (CHAIN, r"c\.yaml:50:6: aliases \(\*\) nest this more than 50 deep"),
        (MERGES, r"c\.yaml:\d+:3: merge keys \(<<\) bring more than 50000 values"),
        ("sizes: [" + "x, " * 40_000 + "]", r"and more; these are the first 100"),
        ("".join(f"key{i}: x\n" for i in range(20_000)), r"and more; these are the first 100"),
        ("".join(f"{i}: x\n" for i in range(20_000)), r"and more; these are the first 100"),
    ],
)
def test_what_would_take_for_ever_is_refused(text: str, said: str) -> None:
    told = complaint(text)
    assert re.search(said, told)
    assert len(told.splitlines()) <= 101


def test_a_large_file_is_not_read_to_its_end(tmp_path: Path) -> None:
    with (tmp_path / "large.yaml").open("wb") as file:
        file.write(b"name: x\n")
        file.truncate(1 << 40)  # takes no room
    with pytest.raises(ConfigError, match=r"large\.yaml:2: here the file is longer than 256 KiB"):
        read_config(tmp_path / "large.yaml", Cluster)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    for path, said in (
        (str(tmp_path / "pipe.yaml"), "it is a pipe, not a regular file"),
        ("/dev/zero", "it is a device, not a regular file"),
        (str(tmp_path), "Is a directory"),
        ("~nobody-of-that-name/c.yaml", "No such file"),
    ):
        with pytest.raises(ConfigError, match=said):
            read_config(path, Cluster)


class Lists(ConfigModel):
    """Lists that need entries."""

    numbers: tuple[int, ...] = Field(min_length=2)
    names: dict[str, int] = Field(default_factory=dict, min_length=1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("numbers: [a, b]", ["numbers[0]", "numbers[1]"]),
        ("numbers: [a]", ["numbers", "numbers[0]"]),
        ("numbers: []", ["numbers"]),
        ("numbers: [1, 2]\nnames: {x: y}", ["names.x"]),
        ("numbers: [1, 2]\nnames: {}", ["names"]),
    ],
)
def test_entries_that_are_wrong_are_not_counted_as_missing(text: str, said: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "c", Lists)
    assert [line.split(": ")[1] for line in str(caught.value).splitlines()] == said


@pytest.mark.parametrize("number", [".nan", ".inf", "-.INF", "1.0e+999"])
def test_numbers_are_finite(number: str) -> None:
    with pytest.raises(ConfigError, match=r"c.yaml:2:5: restarts\[0\].first_s: "):
        parse_config(f"restarts:\n  - first_s: {number}\n", "c.yaml", Cluster)


@pytest.mark.parametrize(
    "text",
    [
        "aws_secret_access_key: geheim",
        "workers: 1\nby_host: {a: {passphrase: geheim}}",
        "workers: 1\napi: {token: geheim}",
    ],
)
def test_no_secret_is_echoed(text: str) -> None:
    class Api(ConfigModel):
        token: int

    class Keys(ConfigModel):
        workers: int = 1
        by_host: dict[str, dict[str, int]] = Field(default_factory=dict)
        api: Api | None = None

    with pytest.raises(ConfigError) as found:
        parse_config(text, "c.yaml", Keys)
    assert str(found.value).startswith("c.yaml:")
    assert "geheim" not in str(found.value)
