"""What others have written, as a terminal may be shown it: visible, and never an order.

A job's log, a worker's failure, a column's name or a machine's answer may hold escape codes that
move the cursor, set the title or answer for the user, and marks that turn the reading direction
round. Whatever is shown passes through here: the log's handler and each line of an error, and by
`echo` what goes to the standard output.
"""

from __future__ import annotations

import json
import logging
import os
import re
import sys
from collections.abc import Sequence

_ORDERS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # control characters but tab and newline
    "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # the reading direction
    "\u2028\u2029"  # ends of lines and paragraphs
    "\ud800-\udfff]"  # bytes of a file's name that are not UTF-8, and halves of characters
)


def visible_text(text: str) -> str:
    r"""Return text with all that a terminal would obey written out; tabs and newlines stay.

    Examples
    --------
    >>> print(visible_text("a\x1b[2Jb\n\u202ec \udcff"))
    a\x1b[2Jb
    \u202ec \xff
    """
    return _ORDERS.sub(_write_out, text)


def visible_line(text: str) -> str:
    r"""Return text as one line: newlines are written out too.

    Examples
    --------
    >>> print(visible_line("a\nhpcapp: done"))
    a\nhpcapp: done
    """
    return visible_text(text).replace("\n", r"\n")


def _write_out(found: re.Match[str]) -> str:
    code = ord(found[0])
    if 0xDC80 <= code <= 0xDCFF:  # how Python keeps a byte that is not UTF-8
        code -= 0xDC00
    return rf"\x{code:02x}" if code < 0x100 else rf"\u{code:04x}"


class VisibleFormatter(logging.Formatter):
    """Formats records of a log as usual, and writes out what a terminal would obey."""

    def format(self, record: logging.LogRecord) -> str:
        """Return a record's text, with its traceback if it has one."""
        return visible_text(super().format(record))


def write_block(excerpt: str) -> str:
    r"""Write an excerpt of somebody else's words as a block: indented and visible.

    Examples
    --------
    >>> print(write_block("Kernel panic\n\n\x1b[2Jnot syncing"))
        Kernel panic
        \x1b[2Jnot syncing
    """
    return "\n".join(f"    {visible_line(line)}" for line in excerpt.splitlines() if line.strip())


def align_rows(rows: Sequence[Sequence[str]], *, numbers: bool = False) -> list[str]:
    r"""Return rows as lines whose columns are as wide as their widest cell, each cell visible.

    Numbers stand below each other at their ends, in all columns but the first.

    Examples
    --------
    >>> align_rows([("JOB", "STATE"), ("1", "do\nne"), ("12", "")])
    ['JOB  STATE', '1    do\\nne', '12']
    >>> align_rows([("", "volume"), ("heap", "9")], numbers=True)
    ['      volume', 'heap       9']
    """
    cells = [[visible_line(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if numbers and k else cell.ljust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]


def echo(text: str, *, err: bool = False) -> None:
    """Print text with a newline behind it, visible; cells of a table have passed `visible_line`."""
    import click  # no worker needs it

    click.echo(visible_text(text), err=err)


def echo_json(value: object) -> None:
    """Print a JSON value on the standard output, in one line of printable ASCII."""
    import click

    click.echo(json.dumps(value).replace("\x7f", r"\u007f"))  # the one that JSON does not write out


def echo_output(text: str) -> None:
    """Print what another program may want as it is: visible on a terminal, else byte for byte.

    It is one line, such as a path or a line of somebody's output.
    """
    import click

    click.echo(visible_line(text) if sys.stdout.isatty() else os.fsencode(text))
