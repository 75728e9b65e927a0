"""Cases that stand for a product of parameters leave out no pair of values."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product

import pytest
from pairs import cover_pairs

PARAMETERS: dict[str, list[Sequence[object]]] = {
    "two": [range(3), range(4)],
    "flags": [[False, True]] * 5,
    "one constant": [range(3), ["always"], range(2)],
    "unlike": [range(6), range(5), range(2), range(3)],
    "lists": [[[], [1]], [{}, {"a": 1}], [None, 0.0, float("nan")]],
}


@pytest.mark.parametrize("name", PARAMETERS)
def test_every_pair_of_values_is_in_a_case(name: str) -> None:
    # By their places, since values may be equal, or have no hash.
    places = [range(len(values)) for values in PARAMETERS[name]]
    cases = cover_pairs(*places)
    for one, other in combinations(range(len(places)), 2):
        found = {(case[one], case[other]) for case in cases}
        assert found == set(product(places[one], places[other]))
    values = [tuple(all_[at] for all_, at in zip(PARAMETERS[name], c, strict=True)) for c in cases]
    assert repr(cover_pairs(*PARAMETERS[name])) == repr(values)


def test_two_parameters_are_their_product() -> None:
    assert cover_pairs("ab", [1, 2, 3]) == list(product("ab", [1, 2, 3]))


@pytest.mark.parametrize(
    ("sizes", "fewest"), [((6, 2, 2), 12), ((5, 2, 2, 2), 10), ((8, 3, 2), 24), ((3, 3, 3), 9)]
)
def test_there_are_as_few_cases_as_can_be(sizes: tuple[int, ...], fewest: int) -> None:
    """As many as the two parameters with the most values have pairs."""
    cases = cover_pairs(*map(range, sizes))
    assert len(cases) == len(set(cases)) == fewest
    assert cases == sorted(cases)
    assert cases == cover_pairs(*map(range, sizes))
