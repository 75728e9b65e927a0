from __future__ import annotations

import pytest

from hpcapp.applications.surface.boundary.lengths import Length, parse_length
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpccomponent.errors import UsageError


def test_a_length_is_one_of_the_input_or_in_spacings() -> None:
    assert parse_length("trim", "1e-3") == Length(0.001, in_spacings=False)
    assert parse_length("trim", "2.5s") == Length(2.5, in_spacings=True)
    assert parse_length("trim", "auto") is None


@pytest.mark.parametrize("text", ["", "s", "3x", "-1", "nan", "inf", "3 m"])
def test_what_is_no_length_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="trim is"):
        parse_length("trim", text)
    with pytest.raises(UsageError, match="fill_holes is"):
        Hierarchical(fill_holes=text)


def test_a_closed_mesh_has_nothing_to_trim() -> None:
    with pytest.raises(UsageError, match="need an open mesh"):
        Hierarchical(close="yes", trim="3s")
