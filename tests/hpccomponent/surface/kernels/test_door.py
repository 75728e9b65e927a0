"""The two builds of the kernels offer the same functions with the same parameters."""

from __future__ import annotations

import inspect

import pytest

from hpccomponent.surface import kernels
from hpccomponent.surface.build import load_native
from hpccomponent.surface.kernels import native, portable

CHOSEN = portable if load_native() is None else native


def test_both_builds_offer_the_same_names() -> None:
    assert native.__all__ == portable.__all__


@pytest.mark.parametrize("name", portable.__all__)
def test_both_builds_take_the_same_parameters(name: str) -> None:
    ours, theirs = (inspect.signature(getattr(build, name)) for build in (portable, native))
    assert list(ours.parameters.items()) == list(theirs.parameters.items())
    assert ours.return_annotation == theirs.return_annotation


@pytest.mark.parametrize("name", portable.__all__)
def test_the_door_gives_the_build_that_was_chosen(name: str) -> None:
    assert getattr(kernels, name) is getattr(CHOSEN, name)
