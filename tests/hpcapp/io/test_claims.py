"""What a file says of itself is believed as far as its size allows, in every format.

Files are read in another process, with a gibibyte of memory beside its libraries.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from mutated_files import GOOD, watch_reading
from small_files import NEEDED, PCD, POINTS, change_e57, change_glb, change_head, make

from hpcapp.geometry.mesh import Mesh
from hpcapp.io import open_points, read_mesh, write_mesh
from hpcapp.io.registry import FORMATS
from hpccomponent.decoding.claims import Claims
from hpccomponent.errors import InputError

SUFFIXES = [
    suffix for one in FORMATS if one.point_reader or one.mesh_reader for suffix in one.suffixes
]
WORDS = ("-2", "-1", "0", "1", "255", "2147483648", "9223372036854775808", "1e300", '"a"', "null")
MOST_NUMBERS = 100  # of a file that are replaced
NUMBERS = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w.])")
CHANGES: dict[str, Callable[[bytes, Callable[[str], str]], bytes]] = {
    ".glb": change_glb,
    ".vtp": lambda content, change: change_head(content, change, b"<AppendedData"),
    ".ply": lambda content, change: change_head(content, change, b"end_header"),
    ".pcd": lambda content, change: change_head(content, change, b"DATA"),
    ".vtk": lambda content, change: change(content.decode("latin-1")).encode("latin-1"),
    ".npy": lambda content, change: change_head(content, change, b"\n"),
    ".ptx": lambda content, change: change_head(content, change, b" 0.5"),
    ".off": lambda content, change: change(content.decode()).encode(),
    ".e57": change_e57,
}


def mutate(path: Path, content: bytes) -> Iterator[Path]:
    """Write a file with each number of its head replaced by each word, and yield its path."""
    found: list[re.Match[str]] = []

    def find(text: str) -> str:
        numbers = list(NUMBERS.finditer(text))
        found.extend(numbers[:: 1 + len(numbers) // MOST_NUMBERS])
        return text

    CHANGES[path.suffix](content, find)
    for one in found:
        for word in WORDS:

            def put(text: str, one: re.Match[str] = one, word: str = word) -> str:
                return text[: one.start()] + word + text[one.end() :]

            path.write_bytes(CHANGES[path.suffix](content, put))
            yield path


@pytest.mark.parametrize(
    "suffix",
    [pytest.param(s, marks=[pytest.mark.slow] if s in NEEDED else []) for s in CHANGES],
)
def test_any_number_of_a_head_may_be_any_other(tmp_path: Path, suffix: str) -> None:
    if suffix in NEEDED:
        pytest.importorskip(NEEDED[suffix], reason=f"{NEEDED[suffix]} is not installed")
    path = tmp_path / f"a{suffix}"
    ends = list(watch_reading(mutate(path, make(path))))
    assert [said for said in ends if said[0] not in GOOD] == []
    assert "refused" in {end for end, *_ in ends}


def claim_accessor(text: str) -> str:
    """Have a view of one row claim 10^8 of them, which lie upon each other."""
    told = json.loads(text)
    told["bufferViews"][0]["byteStride"] = 0
    told["accessors"][0]["count"] = 10**8
    return json.dumps(told)


def claim_instances(text: str) -> str:
    """Place a mesh 5,000 times."""
    told = json.loads(text)
    told["nodes"], told["scenes"] = [{"mesh": 0}] * 5000, [{"nodes": list(range(5000))}]
    return json.dumps(told)


def claim_array(content: bytes) -> bytes:
    """Have the directory of an archive announce 2 GiB for each array."""
    changed = bytearray(content)
    for one in re.finditer(rb"PK\x01\x02", content):
        struct.pack_into("<I", changed, one.start() + 24, 1 << 31)
    return bytes(changed)


def claim_block(word: int) -> bytes:
    """Return a VTP whose points are one block of zeros: so many bytes, as it says, or more."""
    packed = zlib.compress(bytes(1 << 24))
    head = struct.pack("<4I", 1, word, 0, len(packed))
    array = '<DataArray type="Int32" Name="{}" format="appended" offset="0"/>'
    points, polygons = (
        array.format("Points"),
        array.format("connectivity") + array.format("offsets"),
    )
    arrays = f"<Points>{points}</Points><Polys>{polygons}</Polys>"
    xml = f'<VTKFile type="PolyData" compressor="vtkZLibDataCompressor"><PolyData><Piece>{arrays}'
    return f'{xml}</Piece></PolyData><AppendedData encoding="raw">_'.encode() + head + packed


def pack_lzf(size: int) -> bytes:
    """Return what expands to so many zeros, 264 for each three bytes, and two in front."""
    return b"\0\0" + b"\xe0\xff\0" * (size // 264) + bytes([size % 264 - 2]) + bytes(size % 264 - 1)


def lie(path: Path) -> list[bytes]:
    """Return files of a format that claim memory which they may not have."""
    content, huge = make(path), str(10**12)
    text = content.decode("latin-1")
    count = re.compile(r"\b60\b")
    match path.suffix:
        case ".glb":
            places = np.random.default_rng(0).random((9999, 3))
            write_mesh(path, Mesh(places, np.arange(9999).reshape(-1, 3)))
            many = change_glb(path.read_bytes(), claim_instances)
            return [change_glb(content, claim_accessor), many]
        case ".npz":
            return [claim_array(content)]
        case ".vtp":
            return [claim_block(1 << 31), claim_block(100)]
        case ".pcd":
            points = 100_000_000
            packed = pack_lzf(12 * points)
            head = PCD.format(points, "binary_compressed").encode()
            body = struct.pack("<II", len(packed), 12 * points) + packed
            return [head + body, count.sub(huge, text).encode("latin-1")]
        case ".las" | ".laz":
            return [content[:247] + struct.pack("<Q", 10**12) + content[255:]]
        case ".e57":
            return [change_e57(content, lambda xml: xml.replace('"60"', f'"{huge}"', 1))]
        case ".stl":
            return [content[:80] + struct.pack("<I", 2**32 - 1) + content[84:]]
        case ".obj":
            return [content + b"f 1 2 1000000000000\n"]
        case ".ptx":
            return [text.replace("6\n10\n", f"{2**31 - 1}\n{2**31 - 1}\n", 1).encode()]
        case ".ply" | ".vtk" | ".npy" | ".off":
            return [count.sub(huge, text, 1).encode("latin-1")]
        case _:
            rows = text.removeprefix("60\n")
            return [f"{huge}\n{rows}".encode(), f"{huge}\n{rows[:-9]}".encode()]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_a_file_cannot_hold_is_refused_before_it_takes_memory(
    tmp_path: Path, suffix: str
) -> None:
    if suffix in NEEDED:
        pytest.importorskip(NEEDED[suffix], reason=f"{NEEDED[suffix]} is not installed")
    path = tmp_path / f"a{suffix}"

    def liars() -> Iterator[Path]:
        for content in lie(path):
            path.write_bytes(content)
            yield path

    ends = list(watch_reading(liars()))
    assert {end for end, *_ in ends} == {"refused"}, ends


def test_what_is_packed_well_is_read(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", points=np.tile(POINTS, (50_000, 1)) // 1)
    assert open_points(tmp_path / "a.npz").count == 3_000_000
    path = tmp_path / "a.glb"
    content = change_glb(make(path), lambda text: text.replace('"mesh": 0', '"mesh":0'))
    path.write_bytes(content)
    assert len(read_mesh(path).faces) == 3 * 20


def test_claims_are_added_up(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(bytes(1 << 20))
    claims = Claims(path)
    for _ in range(4):
        claims.add((1 << 28) + (1 << 20), "a part")
    with pytest.raises(InputError, match="one more: with that it claims 1077936129 bytes"):
        claims.add(1, "one more")
