"""Files for a loader: what they say arrives, and every mistake is named with its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from hpccomponent.errors import ConfigError
from hpcloader.builds import BUILDS, Build, Requirements
from hpcloader.files import read_catalogue, read_settings
from hpcloader.settings import LoaderSettings
from hpcloader.supervisor import RestartRule

CATALOGUE = """
version: 1
builds:
  - name: big
    requires:
      architecture: [x86_64]
      cpu_flags: [avx2, fma]
      min_cores: 2
      min_memory: 2 GiB
      gpu: H100
      module: my_package._native
    command: ["{python}", -m, mine]
    tasks: [a=b:c]
  - {name: small, command: [x]}
"""
BIG = Requirements(("x86_64",), ("avx2", "fma"), 2, 2**31, "H100", "my_package._native")
WRITTEN = (Build("big", ("{python}", "-m", "mine"), BIG, ("a=b:c",)), Build("small", ("x",)))


def test_a_catalogue_says_what_is_started(tmp_path: Path) -> None:
    (tmp_path / "builds.yaml").write_text(CATALOGUE)
    assert read_catalogue(tmp_path / "builds.yaml") == WRITTEN


def test_a_short_file_leaves_the_rest_as_it_comes_with_the_loader(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text("{}")
    (tmp_path / "loader.yaml").write_text("version: 1\nname: m1\nconnection: c.json")
    expected = LoaderSettings("m1", tmp_path / "c.json", (), RestartRule(), BUILDS)
    assert read_settings(tmp_path / "loader.yaml") == expected


def test_a_long_file_is_obeyed_in_all(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text("{}")
    (tmp_path / "builds.yaml").write_text(CATALOGUE)
    (tmp_path / "loader.yaml").write_text(
        "version: 1\nname: m1\nconnection: c.json\ncatalogue: builds.yaml\ntasks: [d=e:f]\n"
        "restart: {first_s: 3, cap_s: 2, give_up_after: 7}"
    )
    rule = RestartRule(first_s=3.0, cap_s=3.0, give_up_after=7)
    expected = LoaderSettings("m1", tmp_path / "c.json", ("d=e:f",), rule, WRITTEN)
    assert read_settings(tmp_path / "loader.yaml") == expected


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("version: 2\nbuilds: [{name: a, command: [b]}]", "version: should be 1 (got 2)"),
        ("version: 1\nbuilds: []", "builds: has too few entries (got a list)"),
        ("version: 1\nbuilds: [{name: a, command: []}]", "builds[0].command: "),
        ("version: 1\nbuilds: [{name: a, command: ['{pyhton}']}]", "not {pyhton}"),
        ("version: 1\nbuilds: [{name: a b, command: [c]}]", "builds[0].name: "),
        ("version: 1\nbuilds: [{name: a, command: [c], tasks: [x]}]", "builds[0].tasks[0]: "),
        (
            "version: 1\nbuilds: [{name: a, command: [c]}, {name: a, command: [c]}]",
            "two builds are called a",
        ),
        (
            "version: 1\nbuilds: [{name: a, command: [c], requires: {min_memory: 2 PB}}]",
            "should be a size such as",
        ),
        (
            "version: 1\nbuilds: [{name: a, command: [c], requires: {min_core: 2}}]",
            'did you mean "min_cores"?',
        ),
    ],
)
def test_mistakes_in_a_catalogue_are_named(tmp_path: Path, text: str, part: str) -> None:
    path = tmp_path / "builds.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_catalogue(path)
    assert part in str(caught.value)
    assert str(caught.value).startswith(f"{path}:")
