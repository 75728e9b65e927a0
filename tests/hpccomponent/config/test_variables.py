"""Variables in the values of a YAML file."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.config.reader import ConfigModel, parse_config, read_config
from hpccomponent.errors import ConfigError

HOME = {"NAME": "lab", "COUNT": "3", "EMPTY": "", "TWO": "a: b"}


class File(ConfigModel):
    name: str
    count: int = 0
    tags: dict[str, str] | None = None
    items: tuple[str, ...] = ()


def read(text: str) -> File:
    return parse_config(text, "c.yaml", File, environment=HOME)


@pytest.mark.parametrize(
    ("value", "found"),
    [
        ("${NAME}", "lab"), ("x-${NAME}-${NAME}", "x-lab-lab"), ("${NONE:-lab2}", "lab2"),
        ("${EMPTY:-lab3}", "lab3"), ("'${EMPTY}'", ""), ("'${NONE:-}'", ""),
        ("'$${NAME}'", "${NAME}"),
        ("a$b", "a$b"), ("'${COUNT}'", "3"), ('"${TWO}"', "a: b"), ("${TWO}", "a: b"),
    ],
)  # fmt: skip
def test_they_are_filled_in(value: str, found: str) -> None:
    assert read(f"name: {value}").name == found


def test_a_value_without_quotes_is_a_number_where_it_looks_like_one() -> None:
    assert read("name: a\ncount: ${COUNT}").count == 3
    assert read("name: a\ncount: ${NONE:-12}").count == 12
    with pytest.raises(ConfigError, match=r"c\.yaml:2:1: count: "):
        read("name: a\ncount: '${COUNT}'")


def test_they_stand_in_lists_and_mappings_and_not_in_keys() -> None:
    found = read("name: a\nitems: [x, '${NAME}']\ntags: {'${NAME}': '${NAME}'}")
    assert found.items == ("x", "lab")
    assert found.tags == {"${NAME}": "lab"}


def test_an_alias_is_filled_in_once() -> None:
    assert read("name: &n $$${NAME}\nitems: [*n, *n]").items == ("$lab", "$lab")


def test_all_that_are_not_set_are_named_with_their_places() -> None:
    with pytest.raises(ConfigError) as caught:
        read("name: ${NONE}\nitems: ['${ALSO}', '${1}']")
    lines = str(caught.value).splitlines()
    assert lines[0].startswith("c.yaml:1:7: name: NONE is not set: set it")
    assert lines[1].startswith("c.yaml:2:9: items[0]: ALSO is not set")
    assert lines[2].startswith("c.yaml:2:20: items[1]: a variable is written ${NAME}")


BIG = {"BIG": "x" * 100_000, "B": "y" * 1000}


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("name: " + "${BIG}" * 30_000, "1:7"),
        ("name: a\nitems:\n" + "- ${BIG}\n" * 100, "13:3"),
        ("name: &n " + "x" * 100_000 + "\nitems: [" + ", ".join(["*n"] * 30_000) + "]", "1:7"),
        ("name: &n " + "${B}" * 100 + "\nitems: [" + ", ".join(["*n"] * 30_000) + "]", "1:7"),
        ("name: a\n? &n " + "x" * 100_000 + "\n: 1\nitems: [" + "*n, " * 30_000 + "]", "2:3"),
    ],
    ids=["one-value", "many-values", "aliases", "both", "key"],
)
def test_a_file_whose_values_are_more_than_any_cluster_needs_is_refused(
    text: str, place: str
) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "c.yaml", File, environment=BIG)
    assert str(caught.value).startswith(
        f"c.yaml:{place}: what variables and aliases stand for makes this file more than 1024 KiB"
    )
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 300 << 10, "KiB"


def test_a_few_large_values_will_do() -> None:
    found = parse_config("name: ${BIG}${BIG}", "c.yaml", File, environment=BIG)
    assert found.name == 2 * BIG["BIG"]


def test_other_files_take_values_literally(tmp_path: Path) -> None:
    (tmp_path / "loader.yaml").write_text("name: ${NAME}")
    assert read_config(tmp_path / "loader.yaml", File).name == "${NAME}"


@given(st.text())
def test_what_a_variable_holds_is_never_yaml(value: str) -> None:
    found = parse_config("name: '${V}'", "c.yaml", File, environment={"V": value})
    assert found == File(name=value)
