"""What is said of volumes and heights holds the truth, and no more, on pairs that nobody chose."""

from __future__ import annotations

import numpy as np
import pytest
from volumes import KINDS, Row, make_pair, measure_ground, measure_pair, measure_pile

FIRST = 10_000
"""Seeds from here on are those that no number was chosen on."""


def find_ratio(rows: list[Row]) -> float:
    """Return the median of what is said, by the error that it was said of."""
    return float(np.median([row.said / row.off for row in rows]))


@pytest.mark.slow
def test_volumes_are_within_what_is_said() -> None:
    rows = [
        row
        for seed in range(FIRST, FIRST + 6 * len(KINDS))
        for row in measure_pair(make_pair(seed))
        if row.part != "net"
    ]
    assert np.mean([row.off <= row.said for row in rows]) >= 0.92
    assert min(row.told for row in rows) >= 0.0
    # of use, too, where part of the ground changed
    parts = [row for row in rows if row.name.startswith("features") and row.off > 0.0]
    assert find_ratio(parts) < 6.0
    alarms = [row.is_told for row in rows if row.truth == 0.0]
    assert np.mean(alarms) < 0.06


@pytest.mark.slow
def test_heights_are_within_what_is_said() -> None:
    rows = [measure_ground(seed) for seed in range(FIRST, FIRST + 60)]
    assert np.mean([row.told for row in rows]) >= 0.93
    assert find_ratio(rows) < 8.0


@pytest.mark.slow
def test_piles_are_within_what_is_said() -> None:
    rows = [measure_pile(seed) for seed in range(FIRST, FIRST + 6)]
    assert np.mean([row.off <= row.said for row in rows]) > 0.8
