"""Cases in which every two values of different parameters meet, for tests that run whole jobs."""

from __future__ import annotations

import random
from collections.abc import Collection
from itertools import combinations, product
from typing import Any

Case = tuple[int, ...]
Pair = tuple[tuple[int, int], tuple[int, int]]

_DRAWS = 20  # of which the fewest cases are taken


def cover_pairs(*parameters: Collection[Any]) -> list[tuple[Any, ...]]:
    """Return cases, one value of each parameter, in the order of their product; always the same.

    Every value of each parameter occurs with every one of each other parameter. Of two parameters,
    this is their product; of more, those that are left out differ in three or more values at once.
    """
    product_of_all = list(product(*(range(len(values)) for values in parameters)))
    draws = [_cover(product_of_all, random.Random(seed)) for seed in range(_DRAWS)]  # noqa: S311
    fewest = min(draws, key=len)
    listed = [list(values) for values in parameters]
    return [
        tuple(values[at] for values, at in zip(listed, case, strict=True))
        for case in sorted(fewest)
    ]


def _cover(cases: list[Case], chance: random.Random) -> list[Case]:
    """Take the case with the most pairs that are still missing, until none is."""
    shuffled = chance.sample(cases, len(cases))
    missing = {pair for case in cases for pair in _pairs(case)}
    taken = []
    while missing:
        best = max(shuffled, key=lambda case: len(missing & _pairs(case)))
        missing -= _pairs(best)
        taken.append(best)
    return taken


def _pairs(case: Case) -> set[Pair]:
    return set(combinations(enumerate(case), 2))
