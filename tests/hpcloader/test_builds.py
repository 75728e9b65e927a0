"""The catalogue: the first build that fits is chosen, and it is said why the others are not."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from hpccomponent.config import parse_config
from hpccomponent.errors import ConfigError
from hpcloader.builds import Catalogue, choose_build, parse_size, read_catalogue
from hpcloader.machine import Machine

MACHINE = Machine(
    architecture="x86_64",
    cpu_flags=frozenset({"avx", "avx2", "fma"}),
    cores=4,
    memory=8 * 2**30,
    gpus=("NVIDIA H100 80GB",),
    system="Linux 6",
    libc="glibc 2.36",
    python="CPython 3.12.1",
)


def catalogue(requires: dict[str, object], *, is_alone: bool = False) -> Catalogue:
    builds = [{"name": "native", "command": ["{python}", "-m", "x"], "requires": requires}]
    if not is_alone:
        builds.append({"name": "portable", "command": ["{python}", "-m", "y"]})
    return parse_config(json.dumps({"version": 1, "builds": builds}), "b.yaml", Catalogue)


@pytest.mark.parametrize(
    "requires",
    [
        {},
        {"architecture": ["aarch64", "x86_64"]},
        {"cpu_flags": ["avx2", "fma"]},
        {"min_cores": 4},
        {"min_memory": "8 GiB"},
        {"gpu": "any"},
        {"gpu": "h100"},
        {"module": "hpccomponent.errors"},
    ],
)
def test_the_first_that_fits_is_chosen(requires: dict[str, object]) -> None:
    choice = choose_build(catalogue(requires), MACHINE)
    assert choice.build.name == "native"
    assert choice.passed_over == ()


@pytest.mark.parametrize(
    ("requires", "reason"),
    [
        ({"architecture": ["aarch64"]}, "architecture is x86_64, not aarch64"),
        ({"cpu_flags": ["avx2", "avx512f", "amx"]}, "the processor lacks avx512f, amx"),
        ({"min_cores": 8}, "cores: 4, needed 8"),
        ({"min_memory": "16 GiB"}, "memory: 8.0 GiB, needed 16.0"),
        ({"gpu": "L4"}, "no GPU 'L4' among NVIDIA H100 80GB"),
        ({"module": "hpccomponent.surface._nowhere"}, "hpccomponent.surface._nowhere is not"),
        ({"module": "nowhere.at.all"}, "module nowhere.at.all is not installed"),
        ({"min_cores": 8, "architecture": ["arm"]}, "x86_64, not arm, cores: 4, needed 8"),
    ],
)
def test_a_build_that_does_not_fit_is_passed_over_with_the_reason(
    requires: dict[str, object], reason: str
) -> None:
    choice = choose_build(catalogue(requires), MACHINE)
    assert choice.build.name == "portable"
    [(name, said)] = choice.passed_over
    assert name == "native"
    assert reason in said
    with pytest.raises(ConfigError, match="no worker build") as caught:
        choose_build(catalogue(requires, is_alone=True), MACHINE)
    assert reason in str(caught.value)


def test_a_machine_without_gpu_says_so() -> None:
    choice = choose_build(catalogue({"gpu": "any"}), replace(MACHINE, gpus=()))
    assert choice.passed_over == (("native", "no GPU"),)


def test_the_packaged_catalogue_fits_every_machine() -> None:
    poor = replace(MACHINE, architecture="riscv64", cpu_flags=frozenset(), cores=1, gpus=())
    choice = choose_build(read_catalogue(), poor)
    assert choice.build.argv() == [sys.executable, "-P", "-m", "hpccomponent"]


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
            "version: 1\nbuilds: [{name: a, command: [c], requires: {min_memory: 2 GB}}]",
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


@pytest.mark.parametrize(
    ("size", "count"), [(7, 7), ("7", 7), ("2KiB", 2048), ("0.5 gib", 2**29), ("3 TiB", 3 * 2**40)]
)
def test_sizes_are_counted_in_bytes(size: int | str, count: int) -> None:
    assert parse_size(size) == count


@pytest.mark.parametrize("size", ["", "GiB", "-1", "1 GB", "1e3", True])
def test_what_is_no_size_is_refused(size: int | str) -> None:
    with pytest.raises(ValueError, match="512 MiB"):
        parse_size(size)


def test_a_wanted_build_is_chosen_over_better_ones() -> None:
    choice = choose_build(read_catalogue(), MACHINE, "portable")
    assert choice.build.name == "portable"
    with pytest.raises(ConfigError, match="asks for nothing-such"):
        choose_build(read_catalogue(), MACHINE, "nothing-such")
