from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from hpccomponent.files.whole_files import write_whole


def test_who_reads_a_file_that_is_written_again_sees_all_of_it(tmp_path: Path) -> None:
    path = tmp_path / "points.0"
    seen: list[bytes] = []

    def buffers() -> Iterator[bytes]:
        for byte in (b"ab", b"cd"):
            seen.append(path.read_bytes() if path.exists() else b"")
            yield byte

    write_whole(path, buffers())
    assert seen == [b"", b""]
    with path.open("rb") as reader:
        write_whole(path, buffers())
        assert reader.read() == b"abcd"
    assert seen[2:] == [b"abcd", b"abcd"]
    assert os.listdir(tmp_path) == ["points.0"]


def test_what_cannot_be_written_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "points.0"
    path.write_bytes(b"before")

    def buffers() -> Iterator[bytes]:
        yield b"ab"
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="space"):
        write_whole(path, buffers())
    assert path.read_bytes() == b"before"
    assert os.listdir(tmp_path) == ["points.0"]
