from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpcapp.io.points.point_source import Findings
from hpcapp.io.text.tables import RowFormat, RowNotes, is_number, parse_block, parse_sample
from hpccomponent.errors import InputError

PATH = Path("a.xyz")
BLANKS = RowFormat()
COMMAS = RowFormat(",")


def _parse(text: str, rows: RowFormat = BLANKS, first: int = 1) -> tuple[list[list[float]], str]:
    notes, findings = RowNotes(PATH), Findings()
    table = parse_block((first, text), rows, notes)
    notes.tell(findings)
    return table.tolist(), "; ".join(findings.warnings)


@pytest.mark.parametrize(
    "word", ["1", "-1.5", "+.5", "1.", "1e3", "1D+2", "nan", "-INF", "1.#QNAN"]
)
def test_numbers(word: str) -> None:
    assert is_number(word)


@pytest.mark.parametrize("word", ["", "x", "1_0", "0x1", "1,5", "--1", "1.2.3", "e5", "\u0661"])
def test_what_is_no_number(word: str) -> None:
    assert not is_number(word)


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("1 2 3\n4 5 6\n", BLANKS),
        ("1\t2  3 \n\n 4 5 6 # end\n# nothing\n", BLANKS),
        ("// a\n1 2 3\n% b\n;c\n!d\n4 5 6 // e\n", BLANKS),
        ("1,2,3\n4 , 5 , 6,\n", COMMAS),
        ('"1","2","3"\n\n4,5,6', COMMAS),
        ("1;2;3\n 4;5;6;\n", RowFormat(";")),
        ("1,0;2,0;3,0\n4;5;6\n", RowFormat(";", ".")),
        ("1 2,3\n4,5 6\n", RowFormat(None, " ")),
        ("1D0 2 3\n4 5 6\n", BLANKS),
        ('"a b" 1 2 3\nc 4 5 6\n', RowFormat(columns=4, wanted=(1, 2, 3))),
        ('"a, b",1,2,3\nc,4,5,6\n', RowFormat(",", columns=4, wanted=(1, 2, 3))),
    ],
)
def test_dialects(text: str, rows: RowFormat) -> None:
    assert _parse(text, rows) == ([[1, 2, 3], [4, 5, 6]], "")


def test_every_digit_counts() -> None:
    values = np.random.default_rng(1).normal(size=(400, 3)) * 1e6
    text = "".join("{!r} {!r} {!r}\n".format(*row) for row in values.tolist())
    assert _parse(text)[0] == values.tolist()
    odd, _ = _parse(text + "1 2 -nan(ind)\n")  # the exact way, beside the fast one
    assert odd[:-1] == values.tolist()
    assert odd[-1][:2] == [1, 2]


@pytest.mark.parametrize(
    "word",
    [
        "nan",
        "-nan",
        "NAN",
        "-nan(ind)",
        "1.#QNAN",
        "-1.#IND",
        "1.#SNAN00",
        "inf",
        "-Infinity",
        "1.#INF",
    ],
)
def test_numbers_that_are_none(word: str) -> None:
    (row,), said = _parse(f"1 {word} 3\n")
    assert not np.isfinite(row[1])
    assert np.isnan(row[1]) == ("inf" not in word.lower())
    assert said == ""


@pytest.mark.parametrize("word", ["", "NA", "n/a", "null", "None", "-"])
def test_missing_numbers_leave_their_place_empty(word: str) -> None:
    table, said = _parse(f"1,2,3\n4,{word},6\n7,8,{word}\n", COMMAS, 10)
    assert [[x for x in row if x == x] for row in table] == [[1, 2, 3], [4, 6], [7, 8]]
    assert said == "line 11 has an empty field, read as NaN (1 more such lines)"


def test_surplus_numbers_are_passed_over_where_names_say_which() -> None:
    rows = RowFormat(",", takes_surplus=True)
    table, said = _parse("1,2,3\n4,5,6,7\n", rows)
    assert table == [[1, 2, 3], [4, 5, 6]]
    assert said == "line 2 has 4 columns where 3 are expected: the surplus is passed over"
    with pytest.raises(InputError, match=r"a\.xyz:2: 4 columns where 3 are expected"):
        _parse("1,2,3\n4,5,6,7\n", COMMAS)


@pytest.mark.parametrize(
    ("text", "rows", "said"),
    [
        ("1 2 3\n4 5\n", BLANKS, ":2: 2 columns where 3"),
        ("1 2 3\n\n# c\n4 oops 6\n", BLANKS, ":4: 'oops' is not a number; correct"),
        ("1 2 3\n4,5,6\n", BLANKS, ":2: '4,5,6' is not a number"),
        ("1 2 3\n4,5 5 6\n", BLANKS, ":2: '4,5' is not a number; use a decimal point"),
        ("1 2 3\n1_0 2 3\n", BLANKS, ":2: '1_0' is not a number"),
        ("1,2,3\n1 2 3\n", COMMAS, ":2: '1 2 3' is not a number"),
        ("1,2,3\n1,2\n", COMMAS, ":2: 2 columns where 3"),
        ("a 1 2 3\n1 2 3\n", RowFormat(columns=4, wanted=(1, 2, 3)), ":2: 3 columns where 4"),
        ("1 2 3\n" * 1000 + "1 2\n" + "1 2 3\n" * 1000, BLANKS, ":1001: 2 columns"),
    ],
)
def test_what_does_not_fit_is_named(text: str, rows: RowFormat, said: str) -> None:
    with pytest.raises(InputError, match=said):
        _parse(text, rows)


def test_samples_leave_out_what_does_not_fit() -> None:
    lines = ["1,2,3", "1,2", "x,2,3", "4,,6", "7,8,9"]
    sample = parse_sample(lines, COMMAS)
    assert sample[:, 0].tolist() == [1, 4, 7]
    assert parse_sample([], COMMAS).shape == (0, 3)
