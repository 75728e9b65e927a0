from __future__ import annotations

from typing import Any

import pytest

from hpcapp.applications.surface.paper.split_rule import SplitRule
from hpccomponent.errors import UsageError


def test_the_two_readings_of_delta() -> None:
    assert SplitRule(0.1, "paper").limit == 0.1
    assert SplitRule(0.1, "complement").limit == pytest.approx(0.9)


def test_without_a_cone_no_normal_is_too_far() -> None:
    assert SplitRule(1.0, "none").limit < -1.0


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"delta": -1.1}, "delta"),
        ({"delta": float("nan")}, "delta"),
        ({"cone": "wide"}, "cone"),
        ({"max_points": 0}, "max_points"),
    ],
)
def test_values_out_of_range_are_named(options: dict[str, Any], named: str) -> None:
    with pytest.raises(UsageError, match=named):
        SplitRule(**options)
