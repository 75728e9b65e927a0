from __future__ import annotations

from dataclasses import asdict

import pytest

from hpcapp.applications.surface.normals.oriented import Oriented, Unsure

UNSURE = Unsure((1.0, 2.0, 3.0), ("from above", "from below"), ("above", "below"))


@pytest.mark.parametrize("doubt", [None, UNSURE])
def test_a_job_that_goes_on_warns_of_the_same(doubt: Unsure | None) -> None:
    oriented = Oriented("estimated", 0.5, 3, "contradict", "from above", doubt)
    restored = Oriented.of(asdict(oriented))
    assert restored == oriented
    assert restored.warnings == oriented.warnings
