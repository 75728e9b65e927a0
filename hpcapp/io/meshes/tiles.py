"""A mesh as a folder of PLY files, one a tile: for meshes that no program opens as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hpcapp.io.meshes.mesh_stream import MeshStream
from hpcapp.io.ply.format import write_ply_mesh
from hpcapp.io.staging import replacing_folder


def write_tile(path: Path, mesh: MeshStream) -> None:
    """Write a mesh as a new folder with one tile."""
    write_tiles(path, [(0, mesh)])


def write_tiles(path: Path, tiles: Iterable[tuple[int, MeshStream]]) -> None:
    """Write numbered tiles as ``tile-0000.ply``, ``tile-0001.ply`` and so on into a new folder.

    It appears with all or not at all. A vertex that several have is written alike in each.
    """
    with shared_tiles(path) as file_of:
        for index, tile in tiles:
            write_ply_mesh(file_of(index), tile)


@contextmanager
def shared_tiles(path: Path) -> Iterator[Callable[[int], Path]]:
    """Open a new folder for many to write tiles into, as `replacing_folder` does.

    Yield what gives a tile's file, by its number, under its name while it is written.
    """
    with replacing_folder(path) as folder:
        yield lambda index: folder / f"tile-{index:04d}.ply"
