"""Arrays of NPY and NPZ files: read or mapped, and never a pickle.

References
----------
"numpy.lib.format", https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html
"""

from __future__ import annotations

import math
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import IO, Literal

import numpy as np
from numpy.lib import format as npy_format

from hpcapp.io.columns import Numbers
from hpcapp.io.points.point_source import Findings
from hpccomponent.decoding.claims import Claims
from hpccomponent.errors import InputError

_COPY_AGAIN = "copy or export the file again"
_SAVE_NUMBERS = "save arrays of numbers: what is pickled runs as a program, and is never opened"
_DAMAGED = (
    ValueError, TypeError, KeyError, IndexError, OverflowError, EOFError, SyntaxError,
    TokenError, RecursionError, MemoryError, NotImplementedError, RuntimeError, zlib.error,
    zipfile.BadZipFile,
)  # fmt: skip


def is_archive(path: Path) -> bool:
    """Tell by its first bytes whether a file is an NPZ file."""
    with path.open("rb") as file:
        return file.read(2) == b"PK"


def map_array(path: Path) -> Numbers:
    """Map the array of an NPY file, of numbers or of records, into memory.

    Raise InputError where the file is damaged, or its array is of objects.
    """
    size = path.stat().st_size
    if not size:
        raise InputError(f"{path}: the file is empty", "export or copy it again")
    with path.open("rb") as file, _translated(path, "the array"):
        shape, order, dtype = _read_header(file, size, f"{path}: the array")
        if 0 in shape:
            return np.empty(shape, dtype)
        return np.memmap(path, dtype, "r", file.tell(), shape, order)


def read_archive(path: Path, findings: Findings) -> dict[str, Numbers]:
    """Read the arrays of an NPZ file; warn where something follows after one.

    Raise InputError where the file is damaged, or has arrays of objects.
    """
    arrays: dict[str, Numbers] = {}
    claims = Claims(path)
    with _translated(path, "the archive"), zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if not member.filename.endswith(".npy"):
                continue
            name = member.filename.removesuffix(".npy")
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise NotImplementedError(f"compression {member.compress_type} of {name!r}")
            claims.add(member.file_size, f"array {name!r}")
            with _translated(path, f"array {name!r}"), archive.open(member) as file:
                array, following = _read_array(file, member.file_size, f"{path}: array {name!r}")
            arrays[name] = array
            if following:
                findings.warn(f"{following} bytes follow after array {name!r}: they are left out")
    return arrays


def _read_array(file: IO[bytes], size: int, place: str) -> tuple[Numbers, int]:
    """Return an array, and how many bytes follow after it."""
    shape, order, dtype = _read_header(file, size, place)
    content = file.read()  # to its end, so that its checksum is looked at
    array: Numbers = np.ndarray(shape, dtype, content, order=order)
    return array, len(content) - array.nbytes


def _read_header(
    file: IO[bytes], size: int, place: str
) -> tuple[tuple[int, ...], Literal["C", "F"], np.dtype[np.number]]:
    """Return shape, order and type of an array, of which all numbers are there."""
    version = npy_format.read_magic(file)
    read = (
        npy_format.read_array_header_1_0 if version == (1, 0) else npy_format.read_array_header_2_0
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about headers of Python 2
        shape, is_fortran, dtype = read(file)
    if dtype.hasobject:
        raise InputError(f"{place} is one of Python objects, a pickle", _SAVE_NUMBERS)
    least = math.prod(shape) * dtype.itemsize
    if least > size - file.tell():
        raise InputError(
            f"{place} is cut: shape {shape} takes {least} bytes, {size - file.tell()} follow",
            _COPY_AGAIN,
        )
    return shape, "F" if is_fortran else "C", dtype


@contextmanager
def _translated(path: Path, what: str) -> Iterator[None]:
    """Turn the errors of numpy, zipfile and zlib into ours."""
    try:
        yield
    except InputError:
        raise
    except _DAMAGED as error:
        said = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        raise InputError(f"{path}: {what} is damaged: {said}", _COPY_AGAIN) from error
