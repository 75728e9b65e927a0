"""Whether a text ends in the middle of a number: told by its last line alone, which has no end.

A number that is cut is a number, too. What gives it away is how the lines above end: all with as
many digits behind the point, or padded to one length.
"""

from __future__ import annotations

import logging
import re
from functools import partial
from itertools import takewhile, zip_longest
from pathlib import Path

from hpcapp.io.text.tables import is_number

log = logging.getLogger("hpcapp")

_TAIL = 1 << 14  # bytes that are looked at
_SEPARATORS = re.compile(r"[\s,;]+")
_ROUND = 0.1
"""Of numbers, whose last digit is a zero: some programs leave it out."""
_MOST_DOUBT = 0.01
"""How likely it may be that a program that leaves zeros out has written what counts as cut: that
none of k numbers ends in a zero, and the last one in as many as it is short of digits."""


def find_cut(path: Path) -> str | None:
    """Say that a file is cut in its last number, and which that is; None where nothing tells it."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(size - _TAIL, 0))
        tail = file.read().replace(b"\0", b"")  # of UTF-16
    if not tail or tail.endswith((b"\n", b"\r")):
        return None
    *above, last = tail.decode("latin-1").splitlines()[size > _TAIL :] or [""]
    words = _SEPARATORS.split(last.strip())
    alike = list(takewhile(partial(_is_like, words[:-1]), reversed(above)))
    if not alike or not (_lacks_digits(words, alike) or _lacks_padding(last, alike)):
        return None
    return (
        f"the file seems cut: its last line has no end, and its last number, {words[-1][:40]}, is "
        "shorter than those above: copy or export it again"
    )


def warn_of_cut(path: Path) -> None:
    """Log what `find_cut` says of a file."""
    if cut := find_cut(path):
        log.warning("warning: %s: %s", path, cut)


def _is_like(words: list[str], line: str) -> bool:
    """Tell whether a line begins as others do, with one number more at its end."""
    *own, last = _SEPARATORS.split(line.strip())
    pairs = zip(own, words, strict=False)
    return (
        len(own) == len(words)
        and is_number(last)
        and all(a == b or (is_number(a) and is_number(b)) for a, b in pairs)
    )


def _lacks_digits(words: list[str], lines: list[str]) -> bool:
    """Tell whether all numbers have more digits behind the point than the last one."""
    rows = [_SEPARATORS.split(line.strip()) for line in lines]
    numbers = 0
    for column in zip_longest(*rows, words[:-1], fillvalue=rows[0][-1]):
        digits = {len(word.partition(".")[2]) for word in column}
        if len(digits) > 1:
            return False
        numbers += len(column) if digits != {0} else 0
    whole, _, fraction = words[-1].lstrip("+-").partition(".")
    # Of so many digits in all, those before the point leave less room behind it.
    longest = max(len(row[-1].lstrip("+-").partition(".")[0]) for row in rows)
    lacking = len(rows[0][-1].partition(".")[2]) - len(fraction)
    is_cut = lacking > 0 and (1.0 - _ROUND) ** numbers * _ROUND**lacking < _MOST_DOUBT
    return is_cut and whole.isdecimal() and len(whole) <= longest


def _lacks_padding(last: str, lines: list[str]) -> bool:
    """Tell whether lines are padded in front of their numbers to one length, which one lacks."""
    lengths = {len(line) for line in lines}
    are_padded = len(lengths) == 1 and len({len("".join(line.split())) for line in lines}) > 1
    return are_padded and not lines[0][-1].isspace() and len(last) < lengths.pop()
