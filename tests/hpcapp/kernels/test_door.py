"""The two builds of the kernels offer the same functions with the same parameters."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from hpcapp import kernels
from hpcapp.kernels import portable
from hpcapp.kernels.build import load_native

CHOSEN = load_native() or portable
SOURCES = Path(__file__).parents[3] / "hpcapp/kernels"


@pytest.fixture
def native() -> ModuleType:
    extension = load_native("")
    if extension is None:
        pytest.skip("the native kernels are not installed")
    return extension


def list_parameters(kernel: Any) -> list[tuple[str, Any]]:
    """Return the parameters of a function of the extension and their defaults."""
    ((line, _, defaults),) = kernel.__nb_signature__
    found = re.findall(r"(\w+): [^:]*?(?:= \\(\d+))?(?=, \w+: |\) ->)", line)
    return [(name, defaults[int(at)] if at else inspect.Parameter.empty) for name, at in found]


def test_both_builds_offer_the_same_names(native: ModuleType) -> None:
    assert sorted(native.__all__) == portable.KERNELS


@pytest.mark.parametrize("name", portable.KERNELS)
def test_both_builds_take_the_same_parameters(native: ModuleType, name: str) -> None:
    parameters = inspect.signature(getattr(portable, name)).parameters.values()
    expected = [(parameter.name, parameter.default) for parameter in parameters]
    assert list_parameters(getattr(native, name)) == expected


@pytest.mark.parametrize("name", portable.KERNELS)
def test_the_door_gives_the_build_that_was_chosen(name: str) -> None:
    assert getattr(kernels, name) is getattr(CHOSEN, name)


@pytest.mark.parametrize("path", sorted((SOURCES / "native").rglob("*.cpp")), ids=lambda p: p.stem)
def test_kernels_stand_in_files_of_the_same_name_in_both_builds(path: Path) -> None:
    defined = re.findall(r'module\.def\("(\w+)"', path.read_text())
    if defined:
        names = path.relative_to(SOURCES / "native").with_suffix("").parts
        assert set(defined) == {*import_module(".".join([portable.__name__, *names])).__all__}
