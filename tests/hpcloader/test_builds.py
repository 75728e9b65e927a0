"""The catalogue: the first build that fits is chosen, and it is said why the others are not."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest

from hpccomponent.errors import ConfigError
from hpcloader.builds import BUILDS, Build, Requirements, choose_build
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


def catalogue(requires: Requirements, *, is_alone: bool = False) -> list[Build]:
    native = Build("native", ("{python}", "-m", "x"), requires)
    return [native] if is_alone else [native, Build("portable", ("{python}", "-m", "y"))]


@pytest.mark.parametrize(
    "requires",
    [
        Requirements(),
        Requirements(architecture=("aarch64", "x86_64")),
        Requirements(cpu_flags=("avx2", "fma")),
        Requirements(min_cores=4),
        Requirements(min_memory=8 * 2**30),
        Requirements(gpu="any"),
        Requirements(gpu="h100"),
        Requirements(module="hpccomponent.errors"),
    ],
)
def test_the_first_that_fits_is_chosen(requires: Requirements) -> None:
    choice = choose_build(catalogue(requires), MACHINE)
    assert choice.build.name == "native"
    assert choice.passed_over == ()


@pytest.mark.parametrize(
    ("requires", "reason"),
    [
        (Requirements(architecture=("aarch64",)), "architecture is x86_64, not aarch64"),
        (Requirements(cpu_flags=("avx2", "avx512f", "amx")), "the processor lacks avx512f, amx"),
        (Requirements(min_cores=8), "cores: 4, needed 8"),
        (Requirements(min_memory=16 * 2**30), "memory: 8.0 GiB, needed 16.0"),
        (Requirements(gpu="L4"), "no GPU 'L4' among NVIDIA H100 80GB"),
        (
            Requirements(module="hpcapp.applications.surface._nowhere"),
            "hpcapp.applications.surface._nowhere is not",
        ),
        (Requirements(module="nowhere.at.all"), "module nowhere.at.all is not installed"),
        (Requirements(min_cores=8, architecture=("arm",)), "x86_64, not arm, cores: 4, needed 8"),
    ],
)
def test_a_build_that_does_not_fit_is_passed_over_with_the_reason(
    requires: Requirements, reason: str
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
    choice = choose_build(catalogue(Requirements(gpu="any")), replace(MACHINE, gpus=()))
    assert choice.passed_over == (("native", "no GPU"),)


def test_the_packaged_catalogue_fits_every_machine() -> None:
    poor = replace(MACHINE, architecture="riscv64", cpu_flags=frozenset(), cores=1, gpus=())
    choice = choose_build(BUILDS, poor)
    assert choice.build.argv() == [sys.executable, "-P", "-m", "hpccomponent"]


def test_a_wanted_build_is_chosen_over_better_ones() -> None:
    choice = choose_build(BUILDS, MACHINE, "portable")
    assert choice.build.name == "portable"
    with pytest.raises(ConfigError, match="asks for nothing-such"):
        choose_build(BUILDS, MACHINE, "nothing-such")
