"""The XML section of an E57 file, which says where its points are and what they are.

Read here, and checked against the file's size, before libE57 is given the file: that takes any
number for true, and a time that grows with the square of an element's children.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import field
from pathlib import Path
from typing import BinaryIO
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import ByteArray
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_HEADER = struct.Struct("<8sIIQQQQ")  # magic, version, size, place and length of the XML, page
_PAGE, _CHECKSUM = 1024, 4  # bytes; the last of a page are its checksum
_POLYNOMIAL, _ALL_ONES = np.uint32(0x82F63B78), np.uint32(0xFFFFFFFF)  # of CRC-32C
_LONGEST = 1 << 26  # bytes of XML: some thousand belong to a scan
_MOST_ELEMENTS = 500_000  # some sixty belong to a scan
_MOST_CHILDREN = 1000  # of an element that is no list
_DEEPEST = 64  # elements within each other: a field of a scan is the sixth
_LONGEST_TEXT = 1 << 20  # characters of an element that are kept: a CRS takes some thousand
_AT_ONCE = 1 << 20


@dataclass(slots=True, eq=False)
class XmlElement:
    """An element of the document, by its name with the prefix that it has in the file."""

    name: str
    attributes: dict[str, str]
    children: list[XmlElement] = field(default_factory=list)
    text: str = ""

    def find(self, *path: str) -> XmlElement | None:
        """Return the element below this one, named level by level; None where there is none."""
        element = self
        for name in path:
            child = next((child for child in element.children if child.name == name), None)
            if child is None:
                return None
            element = child
        return element

    def number(self, *path: str) -> float | None:
        """Return the number at a place as `find` takes it; None where there is none."""
        element = self.find(*path)
        kind = None if element is None else element.attributes.get("type")
        if element is None or kind not in ("Float", "Integer", "ScaledInteger"):
            return None
        value = float(element.text.strip() or 0)
        return element.scale(value) if kind == "ScaledInteger" else value

    def scale(self, value: float) -> float:
        """Return what an integer of this element stands for."""
        named = self.attributes
        return value * float(named.get("scale", 1)) + float(named.get("offset", 0))


def read_document(path: Path) -> XmlElement:
    """Read the XML section of a file, and return its root.

    Raise InputError where it is no E57 file, is cut, or its XML is not sound.
    """
    with path.open("rb") as file:
        place, length = _find_xml(file, path)
        parser = _DocumentParser(path)
        for part in _read_pages(file, path, place, length):
            parser.feed(part)
    return parser.finish()


def refuse(path: Path, why: str) -> InputError:
    """Make the error for a file that is damaged."""
    return InputError(f"{path}: is no sound E57 file: {why}", "copy or export the file again")


def _find_xml(file: BinaryIO, path: Path) -> tuple[int, int]:
    """Return where the XML begins in the file, and how many bytes it has."""
    head = file.read(_HEADER.size)
    if len(head) < _HEADER.size or not head.startswith(b"ASTM-E57"):
        raise refuse(path, "it does not begin as one")
    _, _, _, stated, place, length, page = _HEADER.unpack(head)
    size = file.seek(0, 2)
    if page != _PAGE:
        raise refuse(path, f"its pages have {page} bytes, not {_PAGE}")
    if stated != size:
        raise refuse(path, f"it says it has {stated} bytes, and has {size}")
    if not _HEADER.size <= place < size or length > size - place:
        raise refuse(path, f"its XML, {length} bytes from byte {place}, lies outside of it")
    if length > _LONGEST:
        raise refuse(path, f"its XML has {length} bytes, more than {_LONGEST}")
    return place, length


def _read_pages(file: BinaryIO, path: Path, place: int, length: int) -> Iterator[bytes]:
    """Yield so many bytes of what the pages hold, from a place in the file on."""
    file.seek(place // _PAGE * _PAGE)
    skipped = place % _PAGE
    while length and (content := file.read(_AT_ONCE)):
        pages = np.frombuffer(content[: len(content) // _PAGE * _PAGE], np.uint8)
        pages = pages.reshape(-1, _PAGE)
        contents = pages[:, :-_CHECKSUM]
        if (sum_pages(contents) != pages[:, -_CHECKSUM:].copy().view(">u4")[:, 0]).any():
            raise refuse(path, "checksum of its XML is wrong")
        part = contents.tobytes()[skipped : skipped + length]
        skipped, length = 0, length - len(part)
        yield part


def sum_pages(pages: ByteArray) -> NDArray[np.uint32]:
    """Return the CRC-32C of each row, as an array of shape (n,).

    Examples
    --------
    >>> print(sum_pages(np.frombuffer(b"123456789", np.uint8)[None]))
    [3808858755]
    """
    table: NDArray[np.uint32] = np.arange(256, dtype=np.uint32)
    bit, byte = np.uint32(1), np.uint32(8)
    for _ in range(8):
        table = table >> bit ^ (table & bit) * _POLYNOMIAL
    sums = np.full(len(pages), _ALL_ONES)
    for column in pages.T:
        sums = sums >> byte ^ table[(sums ^ column) & 255]
    return sums ^ _ALL_ONES


class _DocumentParser:
    """Builds the elements of a document, as far as there may be so many."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._top = XmlElement("", {"type": "Vector"})
        self._open = [self._top]
        self._elements = 0
        self._parser = expat.ParserCreate()
        self._parser.buffer_text = True
        self._parser.buffer_size = 1 << 16
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._add_text
        self._parser.StartDoctypeDeclHandler = self._refuse_declarations

    def feed(self, part: bytes) -> None:
        self._parse(part, False)

    def finish(self) -> XmlElement:
        self._parse(b"", True)
        return self._top.children[0]

    def _parse(self, part: bytes, is_last: bool) -> None:
        try:
            self._parser.Parse(part, is_last)
        except (expat.ExpatError, ValueError, LookupError) as error:  # the latter: encodings
            raise refuse(self._path, f"its XML: {error}") from None

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        parent = self._open[-1]
        self._elements += 1
        if self._elements > _MOST_ELEMENTS:
            raise refuse(self._path, f"its XML has more than {_MOST_ELEMENTS} elements")
        if len(self._open) > _DEEPEST:
            raise refuse(self._path, f"its XML is nested more than {_DEEPEST} deep")
        if len(parent.children) == _MOST_CHILDREN and parent.attributes.get("type") != "Vector":
            raise refuse(
                self._path, f"its XML has more than {_MOST_CHILDREN} elements in {parent.name[:40]}"
            )
        element = XmlElement(name, attributes)
        parent.children.append(element)
        self._open.append(element)

    def _end(self, name: str) -> None:  # noqa: ARG002 - expat has compared it
        self._open.pop()

    def _add_text(self, text: str) -> None:
        element = self._open[-1]
        if len(element.text) < _LONGEST_TEXT:
            element.text += text

    def _refuse_declarations(self, *declared: object) -> None:  # noqa: ARG002
        raise refuse(self._path, "its XML declares a document type")
