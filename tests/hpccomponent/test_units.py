"""One grammar of sizes and durations."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.units import parse_duration, parse_size


@pytest.mark.parametrize(
    ("size", "count"),
    [
        (7, 7), ("7", 7), ("7 B", 7), ("2KiB", 2048), ("2k", 2048), ("0.5 gib", 2**29),
        ("3 TiB", 3 * 2**40), ("800M", 800 * 2**20), ("1 GB", 2**30),
    ],
)  # fmt: skip
def test_sizes_are_counted_in_bytes(size: int | str, count: int) -> None:
    assert parse_size(size) == count


@pytest.mark.parametrize("size", ["", "GiB", "-1", "1 PB", "1e3", "1 G B", "1,5G", True, "9" * 400])
def test_what_is_no_size_is_refused(size: int | str) -> None:
    with pytest.raises(ValueError, match="512M"):
        parse_size(size)


@given(st.integers(1, 10**6), st.sampled_from("smhd"))
def test_durations_are_counted_in_seconds(count: int, unit: str) -> None:
    seconds = {"s": 1, "m": 60, "h": 3600, "d": 86400}[unit]
    assert (
        parse_duration(f"{count}{unit}") == parse_duration(f" {count} {unit} ") == count * seconds
    )


@pytest.mark.parametrize("text", ["", "5", "s", "-1s", "1w", "0s", "1h30m", None])
def test_what_is_no_duration_is_refused(text: object) -> None:
    with pytest.raises(ValueError, match="should be"):
        parse_duration(text)
