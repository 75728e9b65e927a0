"""What is said where a library of an extra is missing."""

from __future__ import annotations

import shlex
import sys
from importlib.metadata import metadata

import pytest
from packaging.requirements import Requirement

from hpcapp.extras import how_to_install

SAID = ("las", "e57", "gis", "ground", "dashboard", "plots", "texture", "dask", "ray")


@pytest.mark.parametrize("extra", SAID)
def test_an_extra_is_installed_by_its_libraries_into_this_python(extra: str) -> None:
    words = shlex.split(how_to_install(extra))
    assert words[:4] == [sys.executable, "-m", "pip", "install"]
    libraries = {Requirement(word).name for word in words[4:]}
    assert libraries
    assert "hpcapp" not in libraries  # no registry has it


def test_every_extra_that_is_named_exists() -> None:
    assert set(SAID) <= set(metadata("hpcapp").get_all("Provides-Extra") or ())
