"""Where a result goes, a file or the standard output, and what comes to lie beside it."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from hpcapp.io.placement import name_beside
from hpcapp.io.registry import find_mesh_writer, find_point_writer
from hpccomponent.files.held_folders import temporary_folder
from hpccomponent.files.outputs import Role, Written


@contextmanager
def open_output(output: str, kind: Literal["mesh", "points"] = "mesh") -> Iterator[Path]:
    """Yield the path to write to.

    ``-`` is the standard output, which gets a PLY at the end.
    """
    if output != "-":
        yield Path(output)
        return
    with temporary_folder() as folder:
        path = folder / f"{kind}.ply"
        yield path
        with path.open("rb") as mesh:
            shutil.copyfileobj(mesh, sys.stdout.buffer)


def list_mesh_files(path: Path, option: str = "", is_textured: bool = False) -> Iterator[Written]:
    """Yield what is written with a mesh; OutputError where its suffix is unknown."""
    writer = find_mesh_writer(path)
    yield Written(path, option, Role.FOLDER if writer.makes_folder else Role.FILE)
    yield Written(name_beside(path), option, is_beside=True)
    if is_textured:
        yield from (Written(f, option, is_beside=True) for f in writer.list_texture_files(path))


def list_point_files(path: Path, option: str = "") -> Iterator[Written]:
    """Yield what is written with points; OutputError where the suffix is unknown."""
    find_point_writer(path)
    yield Written(path, option)
