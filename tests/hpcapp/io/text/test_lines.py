from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from hpcapp.io.text.lines import LineReader, find_encoding, read_blocks, sample_lines
from hpccomponent.errors import InputError

Make = Callable[..., Path]
LINES = "1 2 3\n4 5 6\n7 8 9\n"


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16-le", "utf-16-be", "utf-16"])
def test_encodings_and_line_ends(make_file: Make, encoding: str, end: str) -> None:
    path = make_file("a.txt", LINES.replace("\n", end).encode(encoding))
    found = find_encoding(path)
    assert found.startswith(encoding[:5])
    assert list(read_blocks(path, found)) == [(1, LINES)]


@pytest.mark.parametrize("content", [b"\x7fELF\0\0\1", b"1 2 3\n\0\0", bytes(range(256))])
def test_bytes_that_are_no_text_are_refused(make_file: Make, content: bytes) -> None:
    with pytest.raises(InputError, match=r"a\.txt: no text"):
        find_encoding(make_file("a.txt", content))


def test_blocks_are_whole_lines_and_know_their_numbers(make_file: Make) -> None:
    lines = [f"{i} {'x' * (i % 50)}\n" for i in range(60_000)]
    blocks = list(read_blocks(make_file("a.txt", "".join(lines)), "utf-8"))
    assert len(blocks) > 1
    for number, text in blocks:
        some = text.split("\n")
        assert some[-1] == ""
        assert some[0] == lines[number - 1].rstrip("\n")
    assert "".join(text for _, text in blocks) == "".join(lines)


def test_a_line_without_end_is_refused(make_file: Make) -> None:
    path = make_file("a.txt", "1 2 3\n" + "1" * 2_200_000)
    with pytest.raises(InputError, match=r"a\.txt:2: a line of more than"):
        list(read_blocks(path, "utf-8"))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16-le"])
def test_samples_are_whole_lines_from_all_over_the_file(make_file: Make, encoding: str) -> None:
    lines = [f"{i}.25 {i}.5 {i}.75" for i in range(100_000)]
    path = make_file("a.txt", "\r\n".join([*lines, ""]).encode(encoding))
    sample = sample_lines(path, encoding)
    numbers = [int(line.partition(".")[0]) for line in sample]
    assert [lines[i] for i in numbers] == sample
    assert numbers[0] == 0
    assert numbers[-1] == 99_999
    assert max(b - a for a, b in pairwise(numbers)) < 5_000
    assert sample_lines(make_file("b.txt", LINES), "utf-8") == []


def test_lines_are_read_one_by_one_and_many_at_a_time() -> None:
    blocks = [(1, "a\n\n  \nb\n"), (5, "".join(f"{i}\n" for i in range(200))), (205, "c\nd")]
    lines = LineReader(iter(blocks))
    assert lines.next_line() == (1, "a")
    assert lines.next_line() == (4, "b")
    assert list(lines.take(2)) == [(5, "0\n1\n")]
    assert [(n, text.count("\n")) for n, text in lines.take(150)] == [(7, 150)]
    assert [(n, text.count("\n")) for n, text in lines.take(49)] == [(157, 48), (205, 1)]
    assert list(lines.take(0)) == []
    assert lines.next_line() == (206, "d")
    assert lines.next_line() is None
    assert list(lines.take(5)) == []
