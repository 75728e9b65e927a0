from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hpcapp.io.rows import is_count, numbered, parse_table, take_lines, write_rows
from hpccomponent.errors import InputError

PATH = Path("some.file")


@settings(deadline=None)  # a busy machine is no fault
@given(
    hnp.arrays(np.float64, st.tuples(st.integers(0, 9), st.integers(1, 4)), elements=st.floats())
)
def test_what_is_written_is_parsed(table: np.ndarray) -> None:
    template = " ".join(["%.17g"] * table.shape[1]) + "\n"
    lines = b"".join(write_rows(template, table)).decode().splitlines()
    again = parse_table(numbered(lines), table.shape[1], PATH)
    np.testing.assert_array_equal(again, table)


def test_many_lines_keep_their_order() -> None:
    table = np.arange(100_000.0).reshape(-1, 2)
    lines = b"".join(write_rows("%g %g\n", table)).decode().splitlines()
    assert (parse_table(numbered(lines), 2, PATH) == table).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 2", "2 columns where 3"),
        ("1 2 1_0", "'1_0' is not a number"),
        ("1 2 0x10", "'0x10' is not a number"),
        ("1 2 3,5", "use a decimal point"),
        ("", "0 columns where 3"),
    ],
)
@pytest.mark.parametrize("before", [0, 3, 16383, 16384])
def test_the_line_that_does_not_fit_is_named(text: str, said: str, before: int) -> None:
    lines = [*enumerate(["1 2 3"] * before, 1), (before + 1, text)]
    with pytest.raises(InputError, match=f"some.file:{before + 1}: .*{said}"):
        parse_table(iter(lines), 3, PATH)


def test_lines_that_are_announced_must_come() -> None:
    lines = numbered(["a", "b"])
    assert [text for _, text in take_lines(lines, 1, PATH, "things")] == ["a"]
    with pytest.raises(InputError, match=r"truncated: 2 things are announced, .* after 1"):
        list(take_lines(lines, 2, PATH, "things"))


def test_counts_are_plain_whole_numbers() -> None:
    assert is_count("4000000000")
    assert not any(map(is_count, ["", "-1", "1.0", "1e3", "²", "٣", "9" * 30]))
