"""What others have written reaches a terminal visibly, whichever way it takes."""

from __future__ import annotations

import io
import json
import logging
import unicodedata

import pytest

from hpccomponent.cli.bars import make_bars
from hpccomponent.cli.terminal import (
    VisibleFormatter,
    echo_json,
    visible_line,
    visible_text,
    write_block,
)

EVERYTHING = "".join(map(chr, range(0x110000)))


def test_nothing_that_a_terminal_obeys_is_left() -> None:
    left = set(visible_text(EVERYTHING))
    assert {c for c in left if unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp")} == {"\t", "\n"}
    turning = {"LRE", "RLE", "PDF", "LRO", "RLO", "LRI", "RLI", "FSI", "PDI"}
    assert not {c for c in left if unicodedata.bidirectional(c) in turning}
    assert "\n" not in visible_line(EVERYTHING)
    left.clear()
    visible_text(EVERYTHING).encode()  # halves of characters are written out, too


def test_letters_of_all_languages_stay() -> None:
    words = "Grüße, 你好, שלום, مرحبا, 👩\u200d🚀, a\tb"
    assert visible_text(words) == words


def test_what_is_visible_stays_as_it_is() -> None:
    once = visible_text("\x1b[2J \udcff \n")
    assert once == "\\x1b[2J \\xff \n"
    assert visible_text(once) == once


def test_a_block_hides_no_escape_code_and_no_line() -> None:
    assert write_block("a\x1b[8m\n\n b\x85c") == "    a\\x1b[8m\n     b\n    c"


def test_json_is_printable_and_says_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    value = {"a\x7f\x1b": ["\x00\x9b\u202e\udcff", 1.5, None]}
    echo_json(value)
    line = capsys.readouterr().out
    assert line.endswith("\n")
    assert line[:-1].isascii()
    assert line[:-1].isprintable()
    assert json.loads(line) == value


def test_a_traceback_keeps_its_lines_alone() -> None:
    try:
        raise ValueError("\x1b[2J\nforged")
    except ValueError as error:
        record = logging.LogRecord(
            "x", logging.INFO, "", 1, "it is %s", ("\x07",), (ValueError, error, None)
        )
    said = VisibleFormatter("%(message)s").format(record)
    assert said.splitlines()[0] == "it is \\x07"
    assert "\\x1b[2J" in said
    assert "\x1b" not in said


def test_a_bar_s_name_is_no_mark_up() -> None:
    bars = make_bars(io.StringIO())
    bars.add_task("[link=http://x]fit[/link]", total=None)
    with bars.console.capture() as capture:
        bars.console.print(bars.get_renderable(), width=200)
    assert "[link=http://x]fit[/link]" in capture.get()
