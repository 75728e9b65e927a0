from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.field.weights import (
    BELIEVED,
    LEAST_MU,
    believe_noise,
    localise_noise,
    trust_vertices,
    weigh_levels,
)


def trusted(
    value: float, far: float, count: float, inherited: float, crowd: float = 0.0, depth: int = 0
) -> float:
    values, counts, parents = (np.array([x], np.float32) for x in (value, count, inherited))
    is_finest = np.array([depth == 0])
    return float(trust_vertices(values, np.array([far]), counts, parents, crowd, is_finest)[0])


def test_noise_counts_in_cells_of_each_level() -> None:
    weights = weigh_levels(0.5, 4, 0.1)
    assert [w.noise for w in weights] == pytest.approx([0.04 / 4**depth for depth in range(4)])
    assert weights[0].lam == pytest.approx(0.6)
    assert all(0.0 < w.lam <= 1.0 for w in weights)


def test_the_coarsest_level_has_no_prior_to_compare() -> None:
    weights = weigh_levels(0.5, 3, 0.1)
    assert [w.most_mu > w.least_mu for w in weights] == [True, True, False]
    assert weights[-1].most_mu == LEAST_MU


def test_little_noise_counts_for_less_and_much_for_what_it_is() -> None:
    believed = [believe_noise(noise) for noise in np.linspace(0.0, 2.0, 101)]
    assert believed[0] == BELIEVED < 1.0
    assert believed[-1] == 1.0
    assert np.all(np.diff(believed) >= 0.0)
    assert np.abs(np.diff(believed)).max() < 0.03  # no step


@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e9])
def test_weights_stay_within_bounds(noise: float) -> None:
    for weights in weigh_levels(1.0, 3, noise):
        assert 0.0 < weights.lam <= 1.0


def test_trust_grows_with_the_points_and_with_those_further_up() -> None:
    far = 0.1
    assert trusted(1.0, far, 0.0, 0.0) == 0.0
    assert trusted(1.0, far, 3.0, 0.0) == pytest.approx(0.5)
    assert trusted(1.0, far, 3.0, 8.0) == pytest.approx(1.0)
    assert trusted(1.0, far, 100.0, 100.0) == 1.0


def test_a_sure_far_field_overrules_quadrics_without_points_of_their_own() -> None:
    assert trusted(-1.0, 1.5, 0.0, 100.0) == 0.0
    assert trusted(-1.0, 1.5, 30.0, 100.0) == 1.0
    assert trusted(-1.0, 1.5, 30.0, 100.0, depth=1) == 0.0
    assert trusted(1.0, 1.5, 0.0, 100.0) == 1.0  # they agree
    assert trusted(-1.0, 0.2, 0.0, 100.0) == 1.0  # it is not sure
    assert 0.0 < trusted(-1.0, 0.9, 0.0, 100.0) < 1.0


def test_crowded_coarse_vertices_are_not_trusted() -> None:
    trust = [trusted(1.0, 0.1, 50.0, 50.0, crowd, depth=1) for crowd in (2.0, 9.0, 20.0, np.inf)]
    assert trust[0] == 1.0
    assert 0.0 < trust[1] < 1.0
    assert trust[2:] == [0.0, 0.0]


def localised(overall: float, finer: float, coarser: float) -> float:
    values = (np.array([x], np.float32) for x in (finer, coarser))
    return float(localise_noise(overall, *values)[0])


def test_the_same_residual_in_cells_of_two_sizes_is_noise() -> None:
    assert localised(0.01, 0.02, 0.02) == pytest.approx(0.02)
    assert localised(0.01, 0.005, 0.005) == pytest.approx(0.005)


def test_a_residual_that_grows_with_the_cells_is_detail() -> None:
    assert localised(0.01, 0.03, 0.5) == pytest.approx(0.005)
    assert localised(0.01, 0.03, 0.05) < 0.03


def test_local_noise_stays_within_a_factor_of_the_whole_cloud_s() -> None:
    assert localised(0.01, 1.0, 1.0) == pytest.approx(0.04)
    assert localised(0.01, 0.0, 0.0) == pytest.approx(0.005)
    assert localised(0.0, 1.0, 1.0) == 0.0
