"""LAZ: compressed points, by lazrs, or by laszip where lazrs cannot read them.

Both run in a process of their own: what a damaged file makes them do ends there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from hpcapp.extras import how_to_install
from hpcapp.geometry.points import ByteArray
from hpcapp.io.las.copc import Chunk
from hpcapp.io.las.header import LasHeader
from hpcapp.io.points.point_source import Findings
from hpccomponent.decoding.laz import ONE_STREAM, read_items
from hpccomponent.decoding.process import open_decoder
from hpccomponent.errors import InputError, MissingLibraryError

Take = Callable[[int], ByteArray]
"""Takes so many bytes of points, which come next; they are there until it is called again."""

TakeChunks = Callable[[Sequence[Chunk]], ByteArray]
"""Takes the points of chunks, likewise."""


def find_library(header: LasHeader, path: Path) -> str:
    """Choose the library that decompresses the points of a file.

    Raise InputError where what the compressor makes are no points of the header's length, and
    MissingLibraryError where none that could is installed.
    """
    record = _find_record(header)
    if sum(size for _, size, _ in read_items(record)) != header.record_length:
        raise _damaged(path, "its record of the compressor does not fit the points")
    libraries = ["lazrs", "laszip"]
    if int.from_bytes(record[:2], "little") == ONE_STREAM:
        del libraries[0]
    for library in libraries:
        if find_spec(library) is not None:
            return library
    raise MissingLibraryError(
        f"{path}: compressed points need the package {libraries[0]}", how_to_install("las")
    )


@contextmanager
def open_decompressor(
    path: Path, header: LasHeader, rows: int, findings: Findings
) -> Iterator[Take]:
    """Open the compressed points of a file, of which so many rows are taken at once at most.

    There is a warning, after the last, where the file holds more than its header announces. What is
    yielded raises InputError where points cannot be decompressed; other errors are those of
    `find_library`.
    """
    library = find_library(header, path)
    arguments = [library, str(header.points_start), str(header.count), _find_record(header).hex()]
    size = min(rows, header.count) * header.record_length

    taken = 0

    def refuse(why: str) -> InputError:
        return _damaged(path, f"{why} ({taken} of {header.count} points were read)")

    with open_decoder("laz", path, size, arguments, refuse) as decoder:

        def take(size: int) -> ByteArray:
            nonlocal taken
            if decoder.ask(size) != size:
                raise refuse("they end")
            taken += size // header.record_length
            if taken == header.count and decoder.ask("more"):
                findings.warn(
                    f"the header announces {header.count} points, the file holds more: the others "
                    "are left out"
                )
            return decoder.memory[:size]

        yield take


@contextmanager
def open_chunks(path: Path, header: LasHeader, rows: int) -> Iterator[TakeChunks]:
    """Open the chunks of a COPC file, of which so many points are taken at once at most.

    What is yielded raises InputError where the points cannot be decompressed.
    """
    arguments = ["lazrs", str(header.points_start), str(header.count), _find_record(header).hex()]

    def refuse(why: str) -> InputError:
        return _damaged(path, why)

    with open_decoder("laz", path, rows * header.record_length, arguments, refuse) as decoder:

        def take(chunks: Sequence[Chunk]) -> ByteArray:
            words = [n for chunk in chunks for n in (chunk.at, chunk.size, chunk.points)]
            return decoder.memory[: decoder.ask("chunks", *words)]

        yield take


def _find_record(header: LasHeader) -> bytes:
    return header.records.get(("laszip encoded", 22204), b"")


def _damaged(path: Path, why: str) -> InputError:
    return InputError(
        f"{path}: the points cannot be decompressed: {why}",
        "the file is damaged: copy or export it again",
    )
