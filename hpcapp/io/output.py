"""Where a result goes: a file or the standard output."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal

from hpcapp.io.formats import check_writable
from hpccomponent.errors import OutputError
from hpccomponent.files.held_folders import temporary_folder

_STANDARD_OUTPUT = ("/dev/stdout", "/dev/fd/1", "/proc/self/fd/1")


@contextmanager
def open_output(
    output: str, inputs: Sequence[Path], kind: Literal["mesh", "points"] = "mesh"
) -> Iterator[Path]:
    """Yield the path to write to; find out now whether it can be written.

    Parameters
    ----------
    output : str
        What the user typed; ``-`` is the standard output, which gets a PLY at the end.
    inputs : sequence of Path
        What must not be overwritten.

    Raises
    ------
    OutputError
        Nothing can be written there.
    """
    if output == "-":
        with temporary_folder() as folder:
            path = folder / f"{kind}.ply"
            yield path
            with path.open("rb") as mesh:
                shutil.copyfileobj(mesh, sys.stdout.buffer)
        return
    path = Path(output)
    if output in _STANDARD_OUTPUT:
        raise OutputError(f"{output} cannot be replaced", "give -o - for a PLY there")
    if not output or output.endswith(("/", os.sep)):
        raise OutputError(f"-o {output!r} names no file", "name a file to write to")
    for file in inputs:
        with suppress(
            OSError
        ):  # what cannot be looked at is no input; check_writable says the rest
            if path.samefile(file):
                raise OutputError(f"{path} is the input itself", "give another -o")
    check_writable(path, kind)
    yield path
