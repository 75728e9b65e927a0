"""The causes for which a machine cannot be logged in to."""

from __future__ import annotations

from copy import copy

import pytest

from hpcdeploy.reach import Reach, ReachError


@pytest.mark.parametrize("reach", Reach)
def test_an_error_survives_pickling_with_its_cause(reach: Reach) -> None:
    error = copy(ReachError("head: closed", "open it", reach))  # by way of what pickle uses
    assert (str(error), error.reach, error.exit_code) == ("head: closed; open it", reach, 4)
