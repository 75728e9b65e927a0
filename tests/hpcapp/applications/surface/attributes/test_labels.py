from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.attributes.labels import MOST_LABELS, LabelSearch, find_labels

RNG = np.random.default_rng(3)


@pytest.mark.parametrize(
    "name",
    [
        "classification", "Class", "label_3", "scan", "gps_time", "GpsTime", "point_source_id",
        "return_number", "NumberOfReturns", "segment", "id", "ring", "object_id",
    ],
)  # fmt: skip
def test_what_is_called_a_label_is_one_whatever_it_holds(name: str) -> None:
    assert find_labels({name: RNG.normal(size=500)}) == {name}


@pytest.mark.parametrize("name", ["intensity", "reflectance", "temperature", "wide", "height"])
def test_numbers_of_many_values_are_no_labels(name: str) -> None:
    assert not find_labels({name: RNG.integers(0, 4000, 5000)})
    assert not find_labels({name: RNG.normal(size=500)})


def test_whole_numbers_of_few_values_are_labels_whatever_their_type() -> None:
    values = RNG.integers(0, MOST_LABELS, 5000)
    columns = {kind: values.astype(kind) for kind in ("u1", "i4", "f4", "f8")}
    columns["bool"] = values > 3
    columns["with NaN"] = np.where(values > 60, np.nan, values)
    assert find_labels(columns) == set(columns)


def test_one_value_too_many_and_one_half_make_numbers() -> None:
    values = np.arange(MOST_LABELS + 1)
    halves = np.where(np.arange(50) == 40, 0.5, 1.0)
    assert not find_labels({"a": values, "b": halves})


def test_a_cloud_in_parts_has_the_labels_of_the_whole() -> None:
    few, many = RNG.integers(0, 40, 900), RNG.integers(0, 100, 900)
    search = LabelSearch()
    for rows in np.split(np.arange(900), [10, 11, 500]):
        search.add({"few": few[rows], "many": many[rows]})
    assert search.labels == {"few"}
