"""As many triangles as fit a file: found by writing files and weighing them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from os import PathLike
from pathlib import Path

from hpcapp.geometry.mesh import Mesh
from hpcapp.io import FOLDER_SUFFIXES, place_mesh
from hpcapp.io.crs import Crs
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.placement import Placement
from hpcapp.io.registry import find_mesh_writer
from hpcapp.simplification.mesh import simplify_mesh
from hpcapp.simplification.target import Target
from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import UsageError
from hpccomponent.files.held_folders import temporary_folder
from hpccomponent.units import parse_size

log = logging.getLogger("hpcapp")

_LEAST_BYTES = 16
"""Of a triangle: no format of ours takes fewer, or the first file would be too small."""
_FULL, _AIM = 0.97, 0.985
"""What is enough of the size, and what is aimed at."""
_TRIES = 8


def read_size(size: int | str, output: str | PathLike[str]) -> int:
    """Return the size in bytes that an output is to have, as `parse_size` reads it.

    Raise UsageError where it is no size, or that of no mesh, or the output is a folder.
    """
    try:
        bytes_ = parse_size(size)
    except ValueError as error:
        raise UsageError(f"size is {size!r}", str(error).replace("should be", "give")) from None
    if bytes_ < _LEAST_BYTES:
        raise UsageError(f"size is {size!r}: no mesh fits", "give a size such as 20MB")
    if Path(output).suffix.lower() in FOLDER_SUFFIXES:
        raise UsageError(f"size is of a file, and {output} is a folder", "give faces instead")
    return bytes_


def fit_size(size: int, most: int, weigh: Callable[[int], int]) -> int:
    """Return the most triangles, up to `most`, of which a file has a size in bytes at most.

    `weigh` writes a mesh of so many, and returns its file's bytes. The file is filled to 97 %,
    unless `most` is too few for that. Raise UsageError where no mesh that was tried fits.
    """
    fits, exceeds = 0, most + 1
    faces, written = min(most, max(4, size // _LEAST_BYTES)), 0
    for _ in range(_TRIES):
        written = weigh(faces)
        if written <= size:
            fits = faces
            if faces == most or written >= _FULL * size:
                break
        else:
            exceeds = faces
        # a file grows with its triangles nearly in proportion
        aim = int(faces * _AIM * size / written)
        faces = max(4, min(max(aim, fits + 1), exceeds - 1))
        if faces in (fits, exceeds):
            break
    if not fits:
        raise UsageError(
            f"the mesh does not fit in {size:,} bytes: one of {written:,} is the least",
            "allow for a larger file",
        )
    return fits


def weigh_mesh(path: Path, mesh: MeshStream, placement: Placement) -> int:
    """Write a mesh to be weighed, without a word on it; return the bytes of its file."""
    find_mesh_writer(path).write(path, place_mesh(path, mesh, placement))
    return path.stat().st_size


def leave_unread(
    names: Iterable[str],
    suffix: str,
    named: Collection[str],
    faces: int,
    size: int,
    weigh: Callable[[int], int],
) -> list[str]:
    """Return which attributes stay in a file of a size; say which do not.

    Where a GLB of all `faces` is larger, as `weigh` tells, those go first that were not named: its
    format keeps them for who wrote it, and viewers show none.
    """
    names = list(names)
    unread = [name for name in names if suffix.lower() == ".glb" and name not in named]
    if not unread or (faces * _LEAST_BYTES <= size and weigh(faces) <= size):
        return names
    log.info(
        "left out for the size: %s, which no viewer reads from a .glb; name in %s what is to stay",
        ", ".join(unread), name_option("attributes"),
    )  # fmt: skip
    return [name for name in names if name not in unread]


def fit_mesh(
    mesh: Mesh,
    size: int,
    suffix: str,
    crs: Crs,
    placement: Placement,
    named: Collection[str] = (),
) -> Mesh:
    """Return a mesh of as many triangles as fit a file of a format, of a size in bytes.

    Its suffix names the format; of its attributes those that are `named` stay in any case. Errors
    are those of `fit_size`.
    """
    with temporary_folder() as folder:
        path = folder / f"mesh{suffix}"

        def weigh(faces: int) -> int:
            light = replace(as_stream(simplify_mesh(mesh, Target(faces))), crs=crs)
            return weigh_mesh(path, light, placement)

        most = len(mesh.faces)
        stays = leave_unread(mesh.attributes, suffix, named, most, size, weigh)
        mesh = replace(mesh, attributes={name: mesh.attributes[name] for name in stays})
        return simplify_mesh(mesh, Target(fit_size(size, most, weigh)))
