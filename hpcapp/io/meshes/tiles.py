"""A mesh as a folder of PLY files, one a tile: for meshes that no program opens as a whole."""

from __future__ import annotations

import os
import secrets
import shutil
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hpcapp.io.meshes.mesh_stream import MeshStream
from hpcapp.io.ply.format import write_ply_mesh
from hpccomponent.errors import OutputError
from hpccomponent.files.private_files import make_private_folder

__all__ = ["TILES_SUFFIX", "check_tiles", "new_folder", "shared_tiles", "write_tiles"]

TILES_SUFFIX = ".tiles"
"""Of an output that is to be a folder of tiles."""


def write_tiles(path: Path, tiles: Iterable[tuple[int, MeshStream]]) -> None:
    """Write tiles as ``tile-0000.ply``, ``tile-0001.ply`` and so on into a new folder.

    Parameters
    ----------
    path : Path
        The folder; it appears with all tiles, or not at all.
    tiles : iterable of (int, MeshStream)
        Their numbers and meshes; a vertex that several have is written alike in each.

    Raises
    ------
    OutputError
        The folder holds something, or cannot be written.
    """
    with shared_tiles(path) as file_of:
        for index, tile in tiles:
            write_ply_mesh(file_of(index), tile)


@contextmanager
def shared_tiles(path: Path) -> Iterator[Callable[[int], Path]]:
    """Open a new folder for many to write tiles into.

    Parameters
    ----------
    path : Path
        It appears with all that was written, when the block ends well; else nothing is left.

    Yields
    ------
    callable
        Returns the file of a tile, by its number, under the name that it has while it is written.

    Raises
    ------
    OutputError
        The folder holds something, or cannot be written.
    """
    with new_folder(path) as folder:
        yield lambda index: folder / f"tile-{index:04d}.ply"


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Open a new folder to write files into.

    Parameters
    ----------
    path : Path
        It appears with all that was written, when the block ends well; else nothing is left.

    Yields
    ------
    Path
        The folder, under the name that it has while it is written.

    Raises
    ------
    OutputError
        The folder holds something, or cannot be written.
    """
    check_tiles(path)
    beside = _name_beside(path.absolute())
    try:
        with _translated(path):
            mode = _usual_mode(beside)
            make_private_folder(beside)
            yield beside
            beside.chmod(mode)
            os.replace(beside, path)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def check_tiles(path: Path) -> None:
    """Find out now whether a folder of tiles can be written later, and leave nothing behind.

    Parameters
    ----------
    path : Path
        The folder, which must not be there, or be empty.

    Raises
    ------
    OutputError
        Tiles cannot be written there.
    """
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path}: is not a folder", "tiles need a new folder")
    with _translated(path):
        if path.is_dir() and any(path.iterdir()):
            raise OutputError(f"{path}: is not empty", "name a new folder, or remove this one")
        _usual_mode(_name_beside(path))


def _usual_mode(path: Path) -> int:
    """Return the rights that a new folder of this name has, by making one."""
    path.mkdir()
    mode = stat.S_IMODE(path.stat().st_mode)
    path.rmdir()
    return mode


def _name_beside(path: Path) -> Path:
    return path.with_name(f".hpcapp-{secrets.token_hex(8)}.tmp")


@contextmanager
def _translated(path: Path) -> Iterator[None]:
    """Turn the system's errors of writing a folder into ours."""
    try:
        yield
    except OSError as error:
        there = path.parent.is_dir()
        advice = f"check the name, and that {path.parent} has room and lets you write"
        raise OutputError(
            f"{path}: cannot be written: {error.strerror or error}",
            advice if there else f"create the folder {path.parent} first",
        ) from error
