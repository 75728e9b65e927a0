"""A mesh as a folder of PLY files, one a tile: for meshes that no program opens as a whole."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterable
from pathlib import Path

from hpcapp.io.mesh_stream import MeshStream
from hpcapp.io.ply import write_ply_mesh
from hpccomponent.errors import OutputError

__all__ = ["TILES_SUFFIX", "check_tiles", "write_tiles"]

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
    check_tiles(path)
    beside = path.with_name(f".hpcapp-{secrets.token_hex(8)}.tmp")
    try:
        beside.mkdir()
        for index, tile in tiles:
            write_ply_mesh(beside / f"tile-{index:04d}.ply", tile)
        os.replace(beside, path)
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written: {error.strerror or error}",
            f"check the name, and that {path.parent} has room and lets you write",
        ) from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def check_tiles(path: Path) -> None:
    """Refuse a place for tiles that holds something else, or that lies in no folder.

    Raises
    ------
    OutputError
        Tiles cannot be written there.
    """
    if not path.parent.is_dir():
        raise OutputError(f"{path}: no such folder", f"create the folder {path.parent} first")
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path}: is not a folder", "tiles need a new folder")
    if path.is_dir() and any(path.iterdir()):
        raise OutputError(f"{path}: is not empty", "name a new folder, or remove this one")
