"""The lines of a text file, in blocks: its encoding, its line ends, samples from all over it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from hpccomponent.errors import InputError

Block = tuple[int, str]
"""The number of its first line in the file, counted from 1, and whole lines, ended by LF."""

_HEAD_BYTES = 4096
_BLOCK_CHARACTERS = 1 << 20
_LONGEST_LINE = 1 << 20
_FEW_LINES = 64  # that are found faster one by one
_PIECES = 32
_PIECE_BYTES = 1 << 14
_BYTE_ORDER_MARK = "\ufeff"


def find_encoding(path: Path) -> str:
    """Tell ``utf-8`` from ``utf-16-le`` and ``utf-16-be``, by the mark or by zeros.

    Raise InputError where there are zeros as no text has them.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    for mark, encoding in ((b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be")):
        if head.startswith(mark):
            return encoding
    if 0 not in head:
        return "utf-8"
    pairs = len(head) // 2
    if head[1::2].count(0) == pairs:
        return "utf-16-le"
    if head[0 : 2 * pairs : 2].count(0) == pairs:
        return "utf-16-be"
    raise InputError(f"{path}: no text: it has bytes that are zero", "check the file's suffix")


def read_blocks(path: Path, encoding: str) -> Iterator[Block]:
    """Read a file, about a million characters at a time, without the byte order mark.

    What does not decode becomes U+FFFD. Lines that ended in CR or CR LF end in LF; the last may
    have no end. Raise InputError where a line is longer than a million characters.
    """
    number = 1
    with path.open(encoding=encoding, errors="replace") as file:
        while block := file.read(_BLOCK_CHARACTERS):
            if not block.endswith("\n"):
                rest = file.readline(_LONGEST_LINE)
                if len(rest) == _LONGEST_LINE and not rest.endswith("\n"):
                    line = number + block.count("\n")
                    raise InputError(
                        f"{path}:{line}: a line of more than {_LONGEST_LINE} characters",
                        "check whether the file is text",
                    )
                block += rest
            yield number, block.removeprefix(_BYTE_ORDER_MARK) if number == 1 else block
            number += block.count("\n")


def sample_lines(path: Path, encoding: str) -> list[str]:
    """Read some lines from all over a file, about half a million characters, in its order.

    All lines are whole. None of a file that fits into the first block that is read of it.
    """
    size = path.stat().st_size
    lines: list[str] = []
    if size <= _BLOCK_CHARACTERS:
        return lines
    with path.open("rb") as file:
        for piece in range(_PIECES):
            at = max(size - _PIECE_BYTES, 0) * piece // (_PIECES - 1) // 2 * 2
            file.seek(at)
            text = file.read(_PIECE_BYTES).decode(encoding, errors="replace")
            piece_lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
            lines += piece_lines[bool(at) : -1]
    return lines


class LineReader:
    """Lines one by one, and many at a time, of the same file: of the blocks of `read_blocks`."""

    def __init__(self, blocks: Iterator[Block]) -> None:
        self._blocks = blocks
        self._number, self._text, self._at = 1, "", 0

    def _is_at_end(self) -> bool:
        if self._at == len(self._text):
            self._number, self._text = next(self._blocks, (self._number, ""))
            self._at = 0
        return not self._text

    def next_line(self) -> Block | None:
        """Return the next line that is not blank, without its end; None at the end of the file."""
        while not self._is_at_end():
            number, start = self._number, self._at
            self._advance(1)
            line = self._text[start : self._at]
            if not line.isspace():
                return number, line.removesuffix("\n")
        return None

    def take(self, lines: int) -> Iterator[Block]:
        """Yield the next lines, blank ones counted; fewer at the end of the file."""
        while lines and not self._is_at_end():
            number, start = self._number, self._at
            self._advance(lines)
            lines -= self._number - number
            yield number, self._text[start : self._at]

    def _advance(self, lines: int) -> None:
        """Go on by so many lines, or to the end of the block."""
        if lines > _FEW_LINES:
            left = self._text.count("\n", self._at) + (not self._text.endswith("\n"))
            if left <= lines:
                self._number, self._at = self._number + left, len(self._text)
                return
        for _ in range(lines):
            end = self._text.find("\n", self._at)
            self._number += 1
            self._at = end + 1 if end >= 0 else len(self._text)
            if self._at == len(self._text):
                return
