"""The XML section: what it says is checked against the file before any library sees it."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mutated_files import page_e57, read_pages

from hpcapp.io.e57.document import read_document, sum_pages
from hpcapp.io.e57.points import open_e57
from hpccomponent.errors import InputError

HEADER = struct.Struct("<8sIIQQQQ")
PAGE, HELD = 1024, 1020
FIELDS = "".join(f'<cartesian{axis} type="Float" precision="double"/>' for axis in "XYZ")
POINTS = '<points type="CompressedVector" fileOffset="48" recordCount="{}">{}</points>'

WriteXml = Callable[..., Path]


@pytest.fixture
def write_xml(tmp_path: Path) -> WriteXml:
    """Give a function that writes a file of nothing but XML, whose header says what is told."""

    def write(xml: str, **stated: int) -> Path:
        content = xml.encode()
        size = -(-(HEADER.size + len(content)) // HELD) * PAGE
        told = {"size": size, "place": HEADER.size, "length": len(content), "page": PAGE} | stated
        path = tmp_path / "a.e57"
        path.write_bytes(page_e57(HEADER.pack(b"ASTM-E57", 1, 0, *told.values()) + content))
        return path

    return write


def document(inner: str) -> str:
    return f'<e57Root type="Structure"><data3D type="Vector">{inner}</data3D></e57Root>'


def scan(points: str, rest: str = "") -> str:
    return document(f'<vectorChild type="Structure">{rest}{points}</vectorChild>')


def test_elements(write_xml: WriteXml) -> None:
    text = "ä" * 3000  # over several pages
    numbers = '<a type="ScaledInteger" scale="0.5" offset="1">4</a><b type="Integer"/>'
    root = read_document(write_xml(f"<r><s>{text}</s><t>{numbers}</t></r>"))
    assert root.name == "r"
    assert (found := root.find("s")) is not None
    assert found.text == text
    assert root.number("t", "a") == 3.0
    assert root.number("t", "b") == 0.0
    assert root.number("t", "c") is None
    assert root.number("s") is None


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"size": 5}, "it says it has 5 bytes, and has 1024"),
        ({"place": 2000}, "its XML, 67 bytes from byte 2000, lies outside of it"),
        ({"place": 3}, "from byte 3, lies outside of it"),
        ({"length": 1 << 40}, f"its XML, {1 << 40} bytes from byte 48, lies outside of it"),
        ({"page": 1 << 40}, f"its pages have {1 << 40} bytes, not 1024"),
        ({"length": 50}, "its XML: unclosed token"),
    ],
)
def test_numbers_of_the_header(write_xml: WriteXml, stated: dict[str, int], said: str) -> None:
    with pytest.raises(InputError, match=f"is no sound E57 file: .*{said}"):
        read_document(write_xml(document(""), **stated))


def test_too_much_xml(write_xml: WriteXml) -> None:
    path = write_xml(document(""))
    length = (1 << 26) + 1
    with path.open("r+b") as file:
        file.truncate(1 << 27)
        file.write(HEADER.pack(b"ASTM-E57", 1, 0, 1 << 27, HEADER.size, length, PAGE))
    with pytest.raises(InputError, match=f"its XML has {length} bytes, more than {1 << 26}"):
        read_document(path)


@pytest.mark.parametrize(
    ("xml", "said"),
    [
        ("<r><a></r>", "its XML: mismatched tag"),
        ('<!DOCTYPE r [<!ENTITY a "a">]><r>&a;</r>', "its XML declares a document type"),
        (f"<r>{''.join(f'<a{i}/>' for i in range(1001))}</r>", "more than 1000 elements in r"),
        (100_000 * "<a>" + 100_000 * "</a>", "its XML is nested more than 64 deep"),
        (f'<r type="Vector">{"<a/>" * 500_000}</r>', "more than 500000 elements"),
        ('<?xml version="1.0" encoding="no"?><r/>', "its XML: unknown encoding"),
    ],
)
def test_what_no_file_holds(write_xml: WriteXml, xml: str, said: str) -> None:
    with pytest.raises(InputError, match=f"is no sound E57 file: .*{said}"):
        read_document(write_xml(xml))


def test_lists_may_be_long(write_xml: WriteXml) -> None:
    (found,) = read_document(write_xml(document('<vectorChild type="Integer"/>' * 5000))).children
    assert len(found.children) == 5000


@pytest.mark.parametrize(
    ("xml", "said"),
    [
        (scan(""), "scan 0 says nothing of its points"),
        (
            scan(POINTS.format(10**15, f"<prototype>{FIELDS}</prototype>")),
            f"scan 0 declares {10**15} points of 192 bits, more than the file's 1024 bytes hold",
        ),
        (scan(POINTS.format("many", f"<prototype>{FIELDS}</prototype>")), "its XML: invalid"),
        (
            scan(
                POINTS.format(1, f"<prototype>{FIELDS}</prototype>"),
                '<pose><translation><x type="Float">left</x></translation></pose>',
            ),
            "its XML: could not convert",
        ),
    ],
)
def test_scans(write_xml: WriteXml, xml: str, said: str) -> None:
    with pytest.raises(InputError, match=f"is no sound E57 file: {said}"):
        open_e57(write_xml(xml))


def test_wrong_checksum(write_xml: WriteXml) -> None:
    path = write_xml(document(""))
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match="is no sound E57 file: checksum of its XML is wrong"):
        read_document(path)


def test_pages_are_read_back() -> None:
    held = np.random.default_rng(1).integers(0, 256, 3 * HELD).astype(np.uint8)
    paged = page_e57(held.tobytes())
    assert read_pages(paged) == held.tobytes()
    assert len(set(sum_pages(held.reshape(3, HELD)).tolist())) == 3
