"""The body of a PLY file, ascii or binary, element by element."""

from __future__ import annotations

import sys
from collections.abc import Callable, Container, Iterator
from pathlib import Path

from hpcapp.io.columns import Rows
from hpcapp.io.ply.ascii import scan_ascii
from hpcapp.io.ply.binary import scan_binary
from hpcapp.io.ply.header import Header


def read_body(path: Path, header: Header, wanted: Container[str]) -> dict[str, Rows]:
    """Read elements at once, by their names; see `scan_body`."""
    return dict(scan_body(path, header, wanted, sys.maxsize))


def scan_body(
    path: Path,
    header: Header,
    wanted: Container[str],
    at_once: int,
    warn: Callable[[str], None] | None = None,
) -> Iterator[tuple[str, Rows]]:
    """Read wanted elements in parts of so many rows at most, by name, in the order of the file.

    Rows of a binary file are views, whose memory is given back when the next are asked for; decimal
    numbers of an ascii file are float64. `warn` is told of more points than the header announces;
    without it they are refused. Raise InputError where the body is shorter or longer than the
    header says, or a row is none; what follows after the last row is looked at in the end.
    """
    if header.byte_order:
        return scan_binary(path, header, wanted, at_once, warn)
    return scan_ascii(path, header, wanted, at_once, warn)
