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
    """Read elements in parts.

    Parameters
    ----------
    wanted : container of str
        The names of the elements to read.
    at_once : int
        Rows in a part, at most.
    warn : callable, optional
        Told of more points than the header announces; without it they are refused.

    Yields
    ------
    name : str
        Of the element, in the order of the file.
    rows : Rows
        Its next rows: of a binary file views, whose memory is given back when the next are asked
        for; of an ascii file decimal numbers as float64.

    Raises
    ------
    InputError
        The body is shorter or longer than the header says, or a row is none; what follows after
        the last row is looked at in the end.
    """
    if header.byte_order:
        return scan_binary(path, header, wanted, at_once, warn)
    return scan_ascii(path, header, wanted, at_once, warn)
