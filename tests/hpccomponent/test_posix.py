"""Stand-ins for what a system may lack do what the system would."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hpccomponent import posix

CALLS = ("pread", "preadv", "pwrite", "posix_fallocate")


@pytest.mark.parametrize("is_whole", [True, False])
def test_places_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_whole: bool) -> None:
    if not is_whole:
        for name in CALLS:
            monkeypatch.delattr(os, name, raising=False)
    with (tmp_path / "file").open("w+b", buffering=0) as file:
        posix.reserve(file, 10)
        assert os.fstat(file.fileno()).st_size == 10
        assert posix.write_at(file.fileno(), memoryview(b"abcd"), 3) == 4
        assert posix.read_at(file.fileno(), 6, 2) == b"\0abcd\0"
        room = bytearray(9)
        assert posix.read_into(file.fileno(), memoryview(room)[1:], 4) == 6
        assert bytes(room) == b"\0bcd\0\0\0\0\0"
