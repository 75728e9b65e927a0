"""Whether what was scanned is closed: one probability, of the reading and what no point supports.

A surface that is closed all around has points everywhere. What was seen from one side has none on
half of it, and its normals face one way. What stood on something lacks that side, too, but its
border goes on towards it. A room that is looked at from inside has no far side to be missing.
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.types.reading import Reading

COEFFICIENTS = (-4.23, 13.0, 2.69, -10.7, 7.37)
"""Of 1, the unsupported share, the length of what is missing, that times how far the border draws
together, and 1 where it goes on (`Reading.share_going_on`): the likelihood of ``closed`` of scans
whose truth is known, by ``benchmarks/closing.py``; its tests move each by a tenth."""

SURE = 0.9
"""Probability of being open or closed, below which somebody should look."""


def weigh_open(reading: Reading, unsupported: float) -> float:
    """Return the probability that a scan is open, 0 to 1.

    `unsupported` is the share of the closed surface that no point supports, 0 to 1.
    """
    share = reading.share_going_on
    ends, goes_on = (
        1.0 / (1.0 + np.exp(-np.dot(COEFFICIENTS, measure_opening(reading, unsupported, going_on))))
        for going_on in (0.0, 1.0)
    )
    return float((1.0 - share) * ends + share * goes_on)


def measure_opening(reading: Reading, unsupported: float, going_on: float) -> tuple[float, ...]:
    """Return what `COEFFICIENTS` are of."""
    missing = reading.share_missing
    return 1.0, unsupported, missing, missing * reading.drawn, going_on


def say_closing(reading: Reading, unsupported: float, *, is_open: bool) -> str:
    """Say why a surface is open or closed, for people."""
    share = f"{100.0 * unsupported:.0f} %"
    if is_open:
        return f"open: seen {reading.seen}; no point supports {share} of the closed surface"
    return f"closed: points support {100.0 * (1.0 - unsupported):.0f} % of it"
