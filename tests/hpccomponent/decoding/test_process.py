"""Decoders that misbehave: each ends as an error of the file that they were given."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import pytest

from hpccomponent.decoding.process import Decoder, open_decoder
from hpccomponent.errors import HpcError, InputError, JobError, UsageError

LAZRS = """
import ctypes, mmap, os, signal, sys
Panic = type("PanicException", (BaseException,), {{}})
class LazVlr:
    def __init__(self, record): pass
def read_chunk_table(file, record): return [(1000, 0)]
class ParLasZipDecompressor:
    def __init__(self, file, record): pass
    def decompress_many(self, points):
        points[:] = bytes(range(len(points)))
        {act}
"""
NOTHING = "pass"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A table of no chunks behind a place that says where it is."""
    path = tmp_path / "a.laz"
    path.write_bytes(struct.pack("<QII", 8, 0, 0))
    return path


def decode(
    path: Path, act: str, monkeypatch: pytest.MonkeyPatch, patience_s: float = 60.0
) -> list[bytes]:
    """Decode ten bytes twice with a lazrs that does something behind it."""
    libraries = path.with_name("libraries")
    libraries.mkdir()
    (libraries / "lazrs.py").write_text(LAZRS.format(act=act))
    monkeypatch.syspath_prepend(libraries)
    decoded = []

    def refuse(why: str) -> InputError:
        return InputError(f"{path}: {why}")

    arguments = ["lazrs", "0", "1000", "0000"]
    with open_decoder("laz", path, 10, arguments, refuse, patience_s=patience_s) as decoder:
        for size in (10, 4):
            assert decoder.ask(size) == size
            decoded.append(decoder.memory[:size].tobytes())
    return decoded


def test_memory_is_shared(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert decode(file, NOTHING, monkeypatch) == [bytes(range(10)), bytes(range(4))]


@pytest.mark.parametrize(
    ("act", "error", "said"),
    [
        ("os.abort()", InputError, "its decoder was ended by SIGABRT"),
        ("ctypes.string_at(0)", InputError, "its decoder was ended by SIGSEGV"),
        ("os._exit(7)", InputError, "its decoder was ended by exit code 7"),
        ("os.kill(os.getpid(), signal.SIGXCPU)", InputError, "its decoder takes more than 5 s"),
        (
            "os.kill(os.getpid(), signal.SIGKILL)",
            JobError,
            "a.laz: its decoder was killed; is m",
        ),
        ("raise Panic('of Rust')", InputError, "of Rust"),
        ("raise ValueError('one line\\nand another')", InputError, "one line$"),
        ("raise ValueError", InputError, "ValueError$"),
        ("mmap.mmap(-1, 8 << 30, mmap.MAP_PRIVATE)", InputError, "Cannot allocate memory"),
        ("bytearray(8 << 30)", InputError, "its decoder asks for more than 1024 MiB"),
        ("import no_such_module", UsageError, "No module named 'no_such_module'; install"),
        ("print('noise', flush=True); os.abort()", InputError, "SIGABRT"),
        ("os.close(0); os.closerange(3, 99); os.abort()", InputError, "SIGABRT"),
        ("os.closerange(3, 99); signal.pause()", InputError, "its decoder gave no answer"),
    ],
)
def test_whatever_it_does(
    file: Path, act: str, error: type[HpcError], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(error) as refused:
        decode(file, act, monkeypatch)
    assert re.search(said, str(refused.value))
    assert "\n" not in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("act", "said"),
    [
        ("while True: pass", "its decoder takes more than 5 s"),
        ("signal.pause()", "its decoder gave no answer for 6 s"),
    ],
)
def test_it_hangs(file: Path, act: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    patience_s = 1.0 if "pause" in act else 60.0
    with pytest.raises(InputError, match=said):
        decode(file, act, monkeypatch, patience_s)


def test_left_while_it_works(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing stays of it: the fixtures of all tests look for processes and descriptors."""

    def refuse(why: str) -> InputError:
        return InputError(why)

    def start() -> Decoder:
        with open_decoder("laz", file, 10, ["lazrs", "0", "1000", "0000"], refuse) as decoder:
            return decoder

    assert len(start().memory) == 10
