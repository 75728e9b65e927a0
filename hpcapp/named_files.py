"""Options and arguments that name points, meshes, pages and pictures, by their click types.

Imported for every ``--help``: nothing heavy is imported.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from hpccomponent.cli.named_files import InputFile, OutputFile
from hpccomponent.files.outputs import Role, Written

SHAPE = "shape:"
"""In front of the name of a shape, where a file may be named."""


def _find_beside(path: Path) -> Iterator[Path]:
    """Yield what is read beside a mesh."""
    from hpcapp.io.placement import name_beside  # numpy takes its time

    yield name_beside(path)


def _list_mesh(name: str, option: str, params: Mapping[str, Any]) -> Iterable[Written]:
    from hpcapp.io.output import list_mesh_files

    return list_mesh_files(Path(name), option, params.get("texture") is not None)


def _list_points(name: str, option: str, params: Mapping[str, Any]) -> Iterable[Written]:
    del params
    from hpcapp.io.output import list_point_files

    return list_point_files(Path(name), option)


def _list_storage(name: str, option: str, params: Mapping[str, Any]) -> Iterator[Written]:
    """Yield the folder of ``--temp-dir`` or ``--update``; a bucket holds no file here."""
    del params
    if "://" not in name:
        yield Written(Path(name.removeprefix("folder:")), option, Role.SCRATCH)


SCAN = InputFile(_find_beside)
"""A mesh or points."""
SCANS = InputFile(_find_beside, path_type=str)
"""The same, by patterns too."""
SCAN_OR_WORD = InputFile(_find_beside, is_word=True, path_type=str)
"""The same, or a word that stands for a shape."""
FILE_OR_WORD = InputFile(is_word=True, path_type=str)
"""A file, a folder of cameras, or what would stand in it."""

MESH = OutputFile("mesh", lists=_list_mesh, printed=("-",), path_type=str)
POINTS = OutputFile("points", lists=_list_points, printed=("-",), path_type=str)
PAGE = OutputFile("page", (".html", ".htm"))
PICTURE = OutputFile("picture", (".png",))
STORAGE = OutputFile("folder", role=Role.SCRATCH, lists=_list_storage, path_type=str)
