"""Damage LAZ and E57 files in the places that decoders trust, and see how reading them ends.

``python tests/helpers/mutated_files.py FILE ... --mutations 2000`` prints how many ended in which
way. They are read in another process, which is replaced where it dies or hangs.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import resource
import struct
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from hpcapp.io import open_points, read_mesh, read_whole
from hpcapp.io.e57.document import sum_pages
from hpcapp.io.formats import MESH_SUFFIXES
from hpcapp.io.registry import list_suffixes
from hpccomponent.errors import HpcError

GOOD = ("a cloud", "refused", "refused: the decoder died", "refused: the decoder hung")
"""Ends of reading that are as they should be."""

LONGEST_S = 10.0
MOST_MEMORY = 1 << 30  # bytes, beside what the libraries map
POINT_SUFFIXES = list_suffixes(lambda one: one.point_reader)

_PAGE, _HELD = 1024, 1020
_NUMBERS = (b"0", b"-1", b"1", b"255", b"65536", b"2147483647", b"99999999999999999999", b"1e999")

Change = Callable[[bytearray, np.random.Generator], None]


def mutate(content: bytes, seed: int) -> bytes:
    """Return a file's bytes with some damage, always the same for the same seed.

    Parameters
    ----------
    content : bytes
        Of a LAZ or an E57 file.
    """
    random = np.random.default_rng(seed)
    if content.startswith(b"ASTM-E57"):
        return _mutate_e57(content, random)
    changes: tuple[Change, ...] = (
        _change_any,
        _cut,
        _change_chunk_table,
        _change_records,
        _change_header,
        _change_chunk,
    )
    damaged = bytearray(content)
    changes[random.integers(len(changes))](damaged, random)
    return bytes(damaged)


def _put(damaged: bytearray, start: int, stop: int, random: np.random.Generator) -> None:
    """Change one to eight bytes of a range: each to anything, or several to an extreme number."""
    start, stop = max(start, 0), min(stop, len(damaged))
    if start >= stop:
        return
    at = int(random.integers(start, stop))
    if random.random() < 0.3:
        word = [b"\xff" * 4, b"\0" * 4, b"\xff\xff\xff\x7f", b"\x01\0\0\0", b"\xff" * 8]
        damaged[at : at + 8] = (
            word[random.integers(len(word))][: len(damaged) - at] + damaged[at + 4 : at + 8]
        )
        return
    for place in random.integers(start, stop, random.integers(1, 9)).tolist():
        damaged[place] = int(random.integers(256))


def _change_any(damaged: bytearray, random: np.random.Generator) -> None:
    _put(damaged, 0, len(damaged), random)


def _cut(damaged: bytearray, random: np.random.Generator) -> None:
    del damaged[int(random.integers(len(damaged))) :]


def _change_header(damaged: bytearray, random: np.random.Generator) -> None:
    _put(damaged, 24, 375, random)


def _points_start(damaged: bytearray) -> int:
    return int.from_bytes(damaged[96:100], "little")


def _change_records(damaged: bytearray, random: np.random.Generator) -> None:
    _put(damaged, int.from_bytes(damaged[94:96], "little"), _points_start(damaged), random)


def _change_chunk_table(damaged: bytearray, random: np.random.Generator) -> None:
    start = _points_start(damaged)
    table = int.from_bytes(damaged[start : start + 8], "little")
    if random.random() < 0.2:
        _put(damaged, start, start + 8, random)
    else:
        _put(damaged, table, table + 64, random)


def _change_chunk(damaged: bytearray, random: np.random.Generator) -> None:
    start = _points_start(damaged) + 8
    _put(damaged, start, start + 120, random)


def _mutate_e57(content: bytes, random: np.random.Generator) -> bytes:
    """Damage what the pages hold, and make their checksums right again; or leave them wrong."""
    if random.random() < 0.1:
        damaged = bytearray(content)
        (_change_any, _cut)[random.integers(2)](damaged, random)
        return bytes(damaged)
    held = read_pages(content)
    physical, length = struct.unpack_from("<QQ", held, 24)
    xml = physical // _PAGE * _HELD + physical % _PAGE
    choice = random.random()
    if choice < 0.2:
        _put(held, 0, len(held), random)
    elif choice < 0.4:
        at = random.choice(_find_packets(held, xml))
        _put(held, at, at + 64, random)
    elif choice < 0.5:
        _put(held, 8, 48, random)
    elif choice < 0.6:
        _put(held, xml, xml + length, random)
    elif choice < 0.9:
        _change_number(held, xml, length, random)
    else:
        del held[int(random.integers(48, len(held))) :]
        struct.pack_into("<Q", held, 16, -(-len(held) // _HELD) * _PAGE)
    return page_e57(held)


def _find_packets(held: bytearray, end: int) -> list[int]:
    """Return where headers of sections and packets begin, or may begin."""
    found = [48]
    at = 48 + 32
    while at + 4 < end and len(found) < 1000:
        found.append(at)
        at += int.from_bytes(held[at + 2 : at + 4], "little") + 1
    return found


def _change_number(held: bytearray, xml: int, length: int, random: np.random.Generator) -> None:
    """Put another number in the place of one in the XML, which becomes longer or shorter."""
    text = bytes(held[xml : xml + length])
    found = list(re.finditer(rb"-?\d+(\.\d+)?(e[+-]?\d+)?", text))
    if found:
        one = found[random.integers(len(found))]
        text = text[: one.start()] + _NUMBERS[random.integers(len(_NUMBERS))] + text[one.end() :]
    held[xml:] = text
    struct.pack_into("<Q", held, 16, -(-len(held) // _HELD) * _PAGE)
    struct.pack_into("<Q", held, 32, len(text))


def read_pages(content: bytes) -> bytearray:
    """Return what the pages of an E57 file hold."""
    return bytearray(b"".join(content[at : at + _HELD] for at in range(0, len(content), _PAGE)))


def page_e57(held: bytes | bytearray) -> bytes:
    whole = np.zeros((-(-len(held) // _HELD), _HELD), np.uint8)
    whole.reshape(-1)[: len(held)] = np.frombuffer(held, np.uint8)
    sums = sum_pages(whole).astype(">u4")[:, None].view(np.uint8)
    return np.hstack([whole, sums]).tobytes()


def watch_reading(paths: Iterator[Path]) -> Iterator[tuple[str, str, float]]:
    """Read files, each removed afterwards, and tell how that ended.

    Yields
    ------
    end : str
        One of `GOOD`, or what must not be.
    said : str
        The error's message.
    seconds : float
    """
    context = multiprocessing.get_context("spawn")
    reader: tuple[multiprocessing.process.BaseProcess, Connection] | None = None
    try:
        for path in paths:
            if reader is None:
                ours, theirs = context.Pipe()
                process = context.Process(target=_read_files, args=(theirs,))
                process.start()
                theirs.close()
                reader = process, ours
                ours.recv()  # it is up
            began = time.monotonic()
            reader[1].send(str(path))
            end = _hear(reader[1])
            if end[0] not in GOOD:
                _end(*reader)
                if end[0] == "died":
                    end = (f"died, exit code {reader[0].exitcode}", "")
                reader = None
            yield *end, time.monotonic() - began
            path.unlink()
    finally:
        if reader is not None:
            _end(*reader)


def _end(process: multiprocessing.process.BaseProcess, ours: Connection) -> None:
    ours.close()
    process.join(1.0)
    if process.exitcode is None:
        process.kill()
        process.join()


def _hear(ours: Connection) -> tuple[str, str]:
    if not ours.poll(LONGEST_S):
        return "hung", ""
    try:
        end, said = ours.recv()
    except EOFError:
        return "died", ""
    return end, said


def _read_files(theirs: Connection) -> None:
    """Read files with so little memory that what they claim beyond the rule cannot be had."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MOST_MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    warnings.simplefilter("error")  # each is a line of its own on a terminal
    theirs.send("up")
    while True:
        try:
            path = theirs.recv()
        except EOFError:
            return
        theirs.send(_read(Path(path)))


def _read(path: Path) -> tuple[str, str]:
    """Read points and meshes, as far as a format has both; tell how the last of them ended."""
    end = ("", "")
    if path.suffix in POINT_SUFFIXES:
        end = _try(path, lambda: read_whole(open_points(path)))
    if path.suffix in MESH_SUFFIXES and end[0] in ("", *GOOD):
        end = _try(path, lambda: read_mesh(path))
    return end


def _try(path: Path, read: Callable[[], object]) -> tuple[str, str]:
    try:
        read()
    except HpcError as error:
        said = str(error)
        if error.exit_code != 3 or "\n" in said or str(path) not in said:
            return f"exit code {error.exit_code}", said
        if "decoder was ended" in said:
            return "refused: the decoder died", said
        if "decoder takes more" in said or "no answer" in said:
            return "refused: the decoder hung", said
        return "refused", said
    except BaseException as error:
        return f"{type(error).__name__}", str(error)
    return "a cloud", ""


def write_mutations(files: Sequence[Path], count: int, folder: Path) -> Iterator[Path]:
    """Write mutations of some files, by turns, and yield their paths.

    Parameters
    ----------
    folder : Path
        Where to.
    """
    contents = [(path.read_bytes(), path.suffix) for path in files]
    for seed in range(count):
        content, suffix = contents[seed % len(contents)]
        path = folder / f"{seed}-{files[seed % len(contents)].stem}{suffix}"
        path.write_bytes(mutate(content, seed))
        yield path


def main() -> None:
    """Print how reading mutations of some files ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--mutations", type=int, default=2000)
    parser.add_argument("--keep", type=Path, help="folder for files whose reading ended badly")
    arguments = parser.parse_args()
    ends: Counter[str] = Counter()
    slowest = (0.0, "")
    with tempfile.TemporaryDirectory() as folder:
        written: list[Path] = []

        def paths() -> Iterator[Path]:
            for path in write_mutations(arguments.files, arguments.mutations, Path(folder)):
                written.append(path)
                yield path

        for end, said, seconds in watch_reading(paths()):
            ends[end] += 1
            slowest = max(slowest, (seconds, written[-1].name))
            if end not in GOOD or "decoder" in end:
                sys.stdout.write(f"{written[-1].name}: {end}, {seconds:.1f} s: {said}\n")
                if arguments.keep and end not in GOOD:
                    os.link(written[-1], arguments.keep / written[-1].name)
    for end, times in ends.most_common():
        sys.stdout.write(f"{times:6} {end}\n")
    sys.stdout.write(f"slowest: {slowest[0]:.1f} s, {slowest[1]}\n")


if __name__ == "__main__":
    main()
