"""The body of a binary PLY file, in either byte order.

All of the body is measured, element by element, so that a wrong count or a cut file is found
out wherever it is; only the elements asked for are read.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Callable, Container, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import IntArray
from hpcapp.io.columns import Numbers, Ragged, Rows, positions_within
from hpcapp.io.ply.header import Element, Header, Property
from hpccomponent.errors import InputError

_Body = np.memmap[tuple[int, ...], np.dtype[np.uint8]]

_COPY_AGAIN = "copy or export the file again"
_ROWS_AT_ONCE = 1 << 16


def scan_binary(
    path: Path,
    header: Header,
    wanted: Container[str],
    at_once: int,
    warn: Callable[[str], None] | None = None,
) -> Iterator[tuple[str, Rows]]:
    """Read elements of a binary file in parts; see `scan_body`."""
    body = np.memmap(path, np.uint8, "r")
    at = header.body_start
    for element in header.elements:
        is_wanted = element.name in wanted
        even = _view_even(body, at, element, header.byte_order, path)
        if even is not None:
            for first in range(0, max(element.count, 1), at_once) if is_wanted else ():
                part = even[first : first + at_once]
                yield element.name, _columns(part, element)
                _give_back(body, at + first * even.itemsize, part.nbytes)
            at += even.nbytes
            continue
        step = at_once if is_wanted else _ROWS_AT_ONCE
        for first in range(0, element.count, step):
            start = at
            rows = range(first, min(first + step, element.count))
            lengths, at = _walk(body, at, element, rows, header.byte_order, path)
            if is_wanted:
                yield element.name, _gather(body, start, element, lengths, header.byte_order)
            _give_back(body, start, at - start)
    if body[at : at + 3].tobytes() not in (b"", b"\n", b"\r\n"):
        _pass_over(path, header, body.size - at, warn)


def _pass_over(path: Path, header: Header, size: int, warn: Callable[[str], None] | None) -> None:
    """Leave out so many bytes behind the last element; they are refused if they are no points."""
    if warn is None or not header.filled or not _is_more_of(size, header.filled[-1]):
        raise InputError(
            f"{path}: {size} bytes follow after the last element",
            "a count in the header is too small: export the file again",
        )
    warn(
        f"{size} bytes follow after the {header.filled[-1].count} vertices that the header "
        "announces: they are left out"
    )


def _is_more_of(size: int, element: Element) -> bool:
    """Tell whether so many bytes can be further points."""
    is_whole = not element.lists and size % _row_bytes(element.properties) == 0
    return element.name == "vertex" and is_whole


def find_records(path: Path, header: Header, name: str) -> tuple[int, np.dtype[np.void]] | None:
    """Find an element whose rows are all of one length; None where they are not.

    Return the byte of the file at which the first row starts, and the dtype of a row, whose value i
    is ``v<i>``. Raise InputError where the body ends before the element does, or holds an
    impossible list.
    """
    body = np.memmap(path, np.uint8, "r")
    at = header.body_start
    for element in header.elements:
        even = _view_even(body, at, element, header.byte_order, path)
        if element.name == name:
            break
        if even is not None:
            at += even.nbytes
            continue
        for first in range(0, element.count, _ROWS_AT_ONCE):
            rows = range(first, min(first + _ROWS_AT_ONCE, element.count))
            _, at = _walk(body, at, element, rows, header.byte_order, path)
    return None if even is None else (at, even.dtype)


def _give_back(body: _Body, start: int, size: int) -> None:
    """Let the system take back the memory of a part of the mapped file that has been read."""
    mapped = body._mmap  # type: ignore[attr-defined]
    if hasattr(mapped, "madvise") and size:
        first = start // mmap.ALLOCATIONGRANULARITY * mmap.ALLOCATIONGRANULARITY
        mapped.madvise(mmap.MADV_DONTNEED, first, start + size - first)


def _truncated(path: Path, element: Element, problem: str) -> InputError:
    return InputError(
        f"{path}: truncated: element {element.name!r} ({element.count} rows) {problem}", _COPY_AGAIN
    )


def _negative(path: Path, element: Element, row: int) -> InputError:
    return InputError(
        f"{path}: element {element.name!r}, row {row}: a list of negative length", _COPY_AGAIN
    )


def _row_bytes(properties: tuple[Property, ...]) -> int:
    """Return the size of a row whose lists are empty."""
    return sum(np.dtype(p.count_dtype or p.dtype).itemsize for p in properties)


def _row_dtype(element: Element, lengths: list[int], byte_order: str) -> np.dtype[np.void]:
    """Describe a row whose lists have the given lengths: value i is v<i>, its length n<i>."""
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    remaining = iter(lengths)
    for i, p in enumerate(element.properties):
        if p.count_dtype is None:
            fields.append((f"v{i}", byte_order + p.dtype))
        else:
            fields.append((f"n{i}", byte_order + p.count_dtype))
            fields.append((f"v{i}", byte_order + p.dtype, (next(remaining),)))
    return np.dtype(fields)


def _view_even(
    body: _Body, at: int, element: Element, byte_order: str, path: Path
) -> NDArray[np.void] | None:
    """View the rows as one array if their lists are all as long as the first row's."""
    least = _row_bytes(element.properties) * element.count
    if least > body.size - at:
        raise _truncated(path, element, f"needs {least} bytes or more, {body.size - at} follow")
    lengths = [0] * len(element.lists)
    if element.count:
        lengths = _walk(body, at, element, range(1), byte_order, path)[0][0].tolist()
    dtype = _row_dtype(element, lengths, byte_order)
    if at + dtype.itemsize * element.count > body.size:
        return None
    rows: NDArray[np.void] = np.ndarray(element.count, dtype, body, at)
    counts = [f"n{i}" for i, p in enumerate(element.properties) if p.count_dtype is not None]
    for first in range(0, element.count if counts else 0, _ROWS_AT_ONCE):
        part = rows[first : first + _ROWS_AT_ONCE]
        if not all((part[name] == n).all() for name, n in zip(counts, lengths, strict=True)):
            return None
        _give_back(body, at + first * dtype.itemsize, part.nbytes)
    return rows


def _columns(rows: NDArray[np.void], element: Element) -> Rows:
    result = Rows({}, {})
    for i, p in enumerate(element.properties):
        values = rows[f"v{i}"]
        if p.count_dtype is None:
            result.scalars[p.name] = values
        else:
            lengths = np.full(len(rows), values.shape[1], np.int64)
            result.lists[p.name] = Ragged(lengths, values.ravel())
    return result


def _walk(
    body: NDArray[np.uint8], at: int, element: Element, rows: range, byte_order: str, path: Path
) -> tuple[IntArray, int]:
    """Measure rows of uneven lists one by one.

    Return the lengths (rows, lists), and where the rows end, in bytes.
    """
    steps = []  # for each list: bytes in front, how to read its length, bytes per value
    gap = 0
    for p in element.properties:
        if p.count_dtype is None:
            gap += np.dtype(p.dtype).itemsize
        else:
            count = struct.Struct(byte_order + np.dtype(p.count_dtype).char)
            steps.append((gap, count.unpack_from, count.size, np.dtype(p.dtype).itemsize))
            gap = 0
    view = body.data
    lengths: list[int] = []
    for row in rows:
        try:
            for before, unpack, count_size, value_size in steps:
                at += before
                (length,) = unpack(view, at)
                if length < 0:
                    raise _negative(path, element, row)
                at += count_size + length * value_size
                lengths.append(length)
        except struct.error:
            raise _truncated(path, element, f"ends within row {row}") from None
        at += gap
        if at > body.size:
            raise _truncated(path, element, f"ends within row {row}")
    return np.array(lengths, np.int64).reshape(len(rows), len(steps)), at


def _gather(
    body: NDArray[np.uint8], start: int, element: Element, lengths: IntArray, byte_order: str
) -> Rows:
    """Read rows of uneven lists, whose lengths are known."""
    sizes = np.array([np.dtype(p.dtype).itemsize for p in element.lists])
    row_bytes = _row_bytes(element.properties) + lengths @ sizes
    at = start + np.cumsum(row_bytes) - row_bytes
    result = Rows({}, {})
    for p in element.properties:
        value = np.dtype(byte_order + p.dtype)
        if p.count_dtype is None:
            result.scalars[p.name] = _pick(body, at, value)
            at = at + value.itemsize
            continue
        column = lengths[:, len(result.lists)]
        at = at + np.dtype(p.count_dtype).itemsize
        values_at = np.repeat(at, column) + positions_within(column) * value.itemsize
        result.lists[p.name] = Ragged(column, _pick(body, values_at, value))
        at = at + column * value.itemsize
    return result


def _pick(body: NDArray[np.uint8], at: IntArray, dtype: np.dtype[np.number]) -> Numbers:
    picked = np.asarray(body[at[:, None] + np.arange(dtype.itemsize)])
    return picked.view(dtype)[:, 0]
