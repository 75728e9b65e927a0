from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpcapp.backends.serial import SerialExecutor
from hpcapp.lab.quadrature.application import INTEGRANDS, estimate, integrate
from hpcapp.workforce import Workforce
from hpccomponent.errors import JobError, UsageError

SERIAL = Workforce(SerialExecutor())
TRUTH = {
    "peak": 200.0 * math.atan(50.0),
    "root": 2.0 / 3.0,
    "wave": 0.5 - math.sin(100.0) / 200.0,
}


@pytest.mark.parametrize("name", sorted(INTEGRANDS))
def test_the_integral_is_as_exact_as_asked(name: str) -> None:
    result = integrate(name, 0.0, 1.0, 1e-8, SERIAL)
    assert abs(result.value - TRUTH[name]) < 1e-8
    assert result.error < 1e-8


@given(cut=st.integers(1, 15))
def test_an_interval_does_not_depend_on_its_batch(cut: int) -> None:
    ends = np.linspace(-1.0, 1.0, 17)
    whole = estimate("peak", ends[:-1], ends[1:])
    parts = [estimate("peak", ends[:-1][s], ends[1:][s]) for s in (slice(cut), slice(cut, None))]
    assert np.concatenate(parts).tobytes() == whole.tobytes()


@pytest.mark.parametrize(
    ("name", "left", "right", "tolerance"),
    [
        ("nothing", 0.0, 1.0, 1e-6),
        ("peak", 1.0, 0.0, 1e-6),
        ("peak", 0.0, math.inf, 1e-6),
        ("peak", 0.0, 1.0, 0.0),
        ("peak", 0.0, 1.0, math.nan),
    ],
)
def test_what_cannot_be_asked_is_refused(
    name: str, left: float, right: float, tolerance: float
) -> None:
    with pytest.raises(UsageError):
        integrate(name, left, right, tolerance, SERIAL)


def test_a_tolerance_out_of_reach_is_said_to_be() -> None:
    with pytest.raises(JobError, match="ask for a larger tolerance"):
        integrate("root", -1.0, 1.0, 1e-30, SERIAL)
    with pytest.raises(JobError, match="1000000 intervals"):
        integrate("wave", 0.0, 1e6, 1e-9, SERIAL)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_range_beyond_the_numbers_is_said_to_be() -> None:
    with pytest.raises(JobError, match="choose nearer ends"):
        integrate("root", 0.0, 1e300, 1e-9, SERIAL)
