"""What a user names as points, as one file: several files, patterns, ``-``, compressed ones.

::

    a.ply                              itself
    a.ply.gz, -                        a copy, unpacked, in a temporary folder
    a.laz b.laz, 'scans/*.e57'         one PLY there, with all points (`ply.joined`)
    part.stl --sample 100000           one PLY there, with points on the mesh's faces
    part.stl                           the same for a surface, where its vertices are too few

So every later step, on workers and other machines too, has one file to read.
"""

from __future__ import annotations

import logging
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from hpcapp.io.formats import MESH_SUFFIXES, holds_faces, open_points, read_mesh
from hpcapp.io.points.mesh_samples import SAMPLED, are_vertices_few, sample_faces
from hpcapp.io.points.point_source import PointSource, translated
from hpcapp.io.registry import find_point_reader, list_suffixes
from hpccomponent.decoding.claims import Claims
from hpccomponent.errors import HpcError, InputError, UsageError
from hpccomponent.files.held_folders import temporary_folder
from hpccomponent.files.outputs import STANDARD_INPUT
from hpccomponent.files.paths import expand_pattern
from hpccomponent.limits import is_shortage

if TYPE_CHECKING:
    import gzip


log = logging.getLogger("hpcapp")

Place = Callable[[Sequence[PointSource], Sequence[str]], Sequence[PointSource]]

_PIPED = "-"
_POINT_SUFFIXES = list_suffixes(lambda one: one.point_reader)
_COMPRESSED = ".gz"
_SPOOLED = 0.5  # of what the disk has free
_PIECE = 1 << 20  # bytes
_LARGEST_JUDGED = 1 << 25  # bytes of a mesh: a larger one has vertices enough
_MAGIC = (
    (b"ply", ".ply"), (b"LASF", ".las"), (b"ASTM-E57", ".e57"), (b"\x93NUMPY", ".npy"),
    (b"PK\x03\x04", ".npz"), (b"# .PCD", ".pcd"), (b"VERSION", ".pcd"), (b"# vtk", ".vtk"),
    (b"OFF", ".off"), (b"\x1f\x8b", ".gz"),
)  # fmt: skip


@contextmanager
def gather_points(
    names: Sequence[str],
    sample: int | None = None,
    *,
    for_surface: bool = False,
    goes_elsewhere: bool = False,
    keeps_noise: bool = False,
    choose: Callable[[PointSource], PointSource] | None = None,
    place: Place | None = None,
) -> Iterator[Path]:
    """Yield one file with all points that a user has named.

    It is the file itself where it is one that is read as it is; else one in a temporary folder,
    which goes when the block ends.

    Parameters
    ----------
    names : sequence of str
        Files, patterns as ``scans/*.laz``, or ``-`` for the standard input.
    sample : int, optional
        The files are meshes: so many points on the faces of each are taken.
    for_surface : bool
        Points on the faces are taken, too, of meshes whose vertices are too few for a surface; a
        warning of what is yielded says so.
    goes_elsewhere : bool
        Another machine reads what is yielded: files that need a library become PLYs.
    choose : callable, optional
        Which of the points are asked for, and are written where a file is written; where the file
        itself is yielded, it has them all.
    place : callable, optional
        Brings the files into one frame, given how the user named them; there must be several.

    Raises
    ------
    InputError
        A file cannot be read, or is damaged; the message has the name that the user gave.
    UsageError
        The standard input is named beside other files, or a suffix is unknown.
    """
    files = find_files(names)
    if place is not None and len(files) < 2:
        raise UsageError("there is one file, and nothing to align it with", "name two or more")
    is_one, samples = len(files) == 1, list[int | None]()

    def choose_sample(path: Path) -> int | None:
        return find_sample(path) if for_surface and sample is None else sample

    def stays(file: str | Path) -> bool:
        return is_one and samples == [None] and not (goes_elsewhere and _is_special(file))

    if is_one and not is_packed(files[0]):
        samples = [choose_sample(Path(files[0]))]
        if stays(files[0]):
            yield Path(files[0])
            return
    with temporary_folder() as folder:
        places = [folder / str(number) for number in range(len(files))]
        renamed = {f"{place}/input": _name(file) for place, file in zip(places, files, strict=True)}
        with _named(renamed):
            paths = [_fetch(file, place) for file, place in zip(files, places, strict=True)]
            samples = samples or [choose_sample(path) for path in paths]
        if stays(paths[0]):
            with _named(renamed):
                yield paths[0]
            return
        from hpcapp.io.ply.joined import write_joined

        joined = folder / "points.ply"
        renamed[str(joined)] = _shorten(files)
        with _named(renamed):
            sources = [
                _open(path, points, keeps_noise)
                for path, points in zip(paths, samples, strict=True)
            ]
            unasked = sum(points is not None for points in samples) if sample is None else 0
            placed = sources if place is None else place(sources, [_name(one) for one in files])
            write_joined(joined, placed, choose, unasked * SAMPLED)
            for file, source in zip(files, sources, strict=True):
                _report(file, source)
        with _named(renamed):
            yield joined


def find_files(names: Sequence[str]) -> list[str]:
    """Return the files that a user has named, patterns replaced by the files that fit, sorted.

    Raise InputError where nothing fits a pattern, and UsageError where the standard input is named
    beside other files.
    """
    files: list[str] = []
    for named in names:
        name = _PIPED if named in STANDARD_INPUT else named
        matches = expand_pattern(name)
        if not matches:
            raise InputError(f"{name}: no file fits", "check the pattern")
        files += matches
    if _PIPED in files and len(files) > 1:
        raise UsageError("- reads the standard input, and stands alone", "give files, or -")
    return files


def find_paths(names: Sequence[str]) -> tuple[Path, ...]:
    """Return the files that a user has named, as `find_files` does, without the standard input."""
    return tuple(Path(name) for name in find_files(names) if name != _PIPED)


def find_sample(path: Path) -> int | None:
    """Return how many points on its faces stand for a mesh; None where those of the file do."""
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        return None
    if suffix not in _POINT_SUFFIXES:
        return SAMPLED  # it is read as a mesh alone
    with suppress(InputError, OSError):  # who reads the points will say so
        if path.stat().st_size <= _LARGEST_JUDGED and holds_faces(path):
            return SAMPLED if are_vertices_few(read_mesh(path)) else None
    return None


def is_packed(file: str) -> bool:
    """Tell whether a file must be unpacked, or the standard input read, to look into it."""
    return file == _PIPED or Path(file).suffix.lower() == _COMPRESSED


def _is_special(file: str | Path) -> bool:
    """Tell whether a file is read with a library that is not everywhere."""
    return find_point_reader(Path(file)).needs_library


def _fetch(file: str, folder: Path) -> Path:
    """Return a file that can be read as it is."""
    if not is_packed(file):
        return Path(file)
    folder.mkdir()
    return _unpack(file, folder)


def _unpack(file: str, folder: Path) -> Path:
    """Write what is packed in a file, or comes by the standard input, into a folder."""
    path = folder / "unpacked"
    with path.open("wb", buffering=0) as target, translated(Path(_name(file))):
        if file == _PIPED:
            _spool(iter(partial(sys.stdin.buffer.read, _PIECE), b""), target, file)
        else:
            with open(file, "rb") as packed:
                _decompress(packed, target, file)
    inner = "" if file == _PIPED else Path(Path(file).stem).suffix
    suffix = inner or _guess_suffix(path)
    if not suffix:
        raise InputError(f"{_name(file)} is empty", "check what it was made of")
    named = path.rename(folder / f"input{suffix}")
    return _unpack(str(named), folder) if suffix == _COMPRESSED else named


def _guess_suffix(path: Path) -> str:
    """Return the suffix that a file should have by its first bytes; none where it has none."""
    with path.open("rb") as file:
        head = file.read(16)
    guess = next((suffix for magic, suffix in _MAGIC if head.startswith(magic)), ".xyz")
    return guess if head else ""


def _name(file: str) -> str:
    return "the standard input" if file == _PIPED else file


def _spool(pieces: Iterable[bytes], target: FileIO, file: str) -> None:
    """Copy what comes, as far as the disk has room for it and for the job: it may have no end."""
    folder = tempfile.gettempdir()
    allowed, written = int(_SPOOLED * shutil.disk_usage(folder).free), 0
    for piece in pieces:
        written += len(piece)
        if written > allowed:
            raise _endless(file, folder, written)
        try:
            while piece:
                piece = piece[target.write(piece) :]
        except OSError as error:
            if not is_shortage(error):
                raise
            raise _endless(file, folder, written) from error


def _endless(file: str, folder: str, written: int) -> InputError:
    return InputError(
        f"{_name(file)}: no end after {written >> 20} MiB, and no more room for a copy in {folder}",
        "check that it ends; or set TMPDIR to a folder with more room, of which half may be taken",
    )


def _decompress(packed: BinaryIO, target: FileIO, file: str) -> None:
    import gzip
    import zlib

    try:
        with gzip.open(packed) as stream:
            _spool(_inflate(stream, Claims(Path(file))), target, file)
    except EOFError:
        raise InputError(
            f"{file}: cut: it ends before its compressed data do", "copy the file again"
        ) from None
    except (gzip.BadGzipFile, zlib.error) as error:
        raise InputError(
            f"{file}: damaged, or not compressed by gzip: {error}", "copy the file again"
        ) from None


def _inflate(stream: gzip.GzipFile, claims: Claims) -> Iterator[bytes]:
    while piece := stream.read(_PIECE):
        claims.add(len(piece), "what it unpacks to")
        yield piece


def _open(path: Path, sample: int | None, keeps_noise: bool) -> PointSource:
    if sample is None:
        return open_points(path, keeps_noise=keeps_noise)
    from hpcapp.io.points.mesh_points import slice_cloud

    mesh = read_mesh(path)
    points = sample_faces(mesh, sample)
    placed = replace(points, positions=points.positions + mesh.origin)
    return slice_cloud(path, "a sampled mesh", placed)


def _report(file: str, source: PointSource) -> None:
    """Log what is odd about a file that is read now and not again."""
    for line in source.findings.lines():
        log.warning("warning: %s: %s", file, line)


def _shorten(files: Sequence[str]) -> str:
    return files[0] if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"


@contextmanager
def _named(renamed: dict[str, str]) -> Iterator[None]:
    """Say the user's names in the messages of errors, not those of copies."""
    try:
        yield
    except HpcError as error:
        problem = error.problem
        for ours, name in renamed.items():  # with any suffix
            problem = re.sub(re.escape(ours) + r"[.\w]*", name.replace("\\", r"\\"), problem)
        if problem == error.problem:
            raise
        raise type(error)(problem, error.advice, error.excerpt) from error
