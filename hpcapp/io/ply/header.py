"""The header of a PLY file: what elements the body holds, and how they are encoded.

References
----------
Greg Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import field
from pathlib import Path

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_SPELLINGS = {
    "i1": ("char", "int8"),
    "u1": ("uchar", "uint8"),
    "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"),
    "i4": ("int", "int32"),
    "u4": ("uint", "uint32"),
    "f4": ("float", "float32"),
    "f8": ("double", "float64"),
}
SCALAR_TYPES = {name: dtype for dtype, names in _SPELLINGS.items() for name in names}
"""Every scalar type of PLY, under both spellings, as a numpy type without byte order."""

_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_KEYWORDS = ("comment", "obj_info", "format", "element", "property")
_FIRST_LINE = re.compile(rb"(?:\xef\xbb\xbf)?ply[ \t]*(\r\n|\n|\r)")
_LAST_LINE = (
    re.compile(rb"[\r\n]end_header[ \t]*(?:\r?\n|\Z)"),
    re.compile(rb"[\r\n]end_header[ \t]*(?:\r|\Z)"),
)
_LONGEST_HEADER = 1 << 20
_EXPORT_AGAIN = "export the file again as PLY 1.0"


@dataclass(frozen=True, slots=True)
class Property:
    """A property of an element, as the header spells and declares it in a line.

    The type is that of the value, or of each value of a list: a numpy type without byte order; the
    other one is of the length in front of a list, None for a scalar.
    """

    name: str
    dtype: str
    count_dtype: str | None = None
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Element:
    """An element: so many rows of the same properties."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def scalars(self) -> tuple[Property, ...]:
        """Its properties of one value in each row."""
        return tuple(p for p in self.properties if p.count_dtype is None)

    @property
    def lists(self) -> tuple[Property, ...]:
        """Its other properties: with these its rows may differ in length."""
        return tuple(p for p in self.properties if p.count_dtype is not None)


@dataclass(frozen=True, slots=True)
class Header:
    """What stands in front of the body.

    Parameters
    ----------
    byte_order : str
        "<" or ">" for a binary body, "" for ascii.
    elements : tuple of Element
        In the order of the body.
    body_start : int
        Where the body starts, in bytes from the start of the file.
    body_line : int
        The number of the body's first line, counted from 1.
    warnings : tuple of str
        What is odd about the header, and was passed over.
    comments : tuple of tuple of str
        The words behind ``comment`` of each such line.
    remarks : dict of str to str
        What lines of ``obj_info`` say of one word: ``num_cols 512``.
    """

    byte_order: str
    elements: tuple[Element, ...]
    body_start: int
    body_line: int
    warnings: tuple[str, ...] = ()
    comments: tuple[tuple[str, ...], ...] = ()
    remarks: Mapping[str, str] = field(default_factory=dict)

    def find(self, name: str) -> Element | None:
        """Return the element of a name."""
        return next((element for element in self.elements if element.name == name), None)

    @property
    def filled(self) -> tuple[Element, ...]:
        """The elements that have rows."""
        return tuple(element for element in self.elements if element.count)


def read_header(path: Path) -> Header:
    """Read the header of a PLY file.

    Raise InputError where the file is empty, is no PLY, or a line of its header is wrong.
    """
    with path.open("rb") as file:
        head = file.read(_LONGEST_HEADER)
    if not head:
        raise InputError(f"{path}: the file is empty", "export or copy it again")
    first = _FIRST_LINE.match(head)
    if first is None:
        raise InputError(
            f"{path}: not a PLY file: its first line is not 'ply'", "check the file and its suffix"
        )
    # A lone CR ends the header only where it ends lines: otherwise the next byte may be an LF
    # that belongs to it, or to a binary body.
    end = _LAST_LINE[first[1] == b"\r"].search(head)
    if end is None:
        raise InputError(f"{path}: the PLY header has no 'end_header'", _EXPORT_AGAIN)
    # Bytes know no line ends but these: comments may hold any character.
    lines = head[: end.end()].splitlines()
    parser = _HeaderParser(path)
    for number, line in enumerate(lines[1:-1], start=2):
        parser.line(number, [word.decode("utf-8", "backslashreplace") for word in line.split()])
    return parser.make_header(end.end(), len(lines) + 1)


class _HeaderParser:
    """Takes the header line by line; the last element collects the properties that follow."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.byte_order: str | None = None
        self.counts: dict[str, int] = {}
        self.elements: dict[str, dict[str, Property]] = {}
        self.warnings: list[str] = []
        self.comments: list[tuple[str, ...]] = []
        self.remarks: dict[str, str] = {}

    def line(self, number: int, words: list[str]) -> None:
        """Take one line, split into words."""
        match words:
            case ["obj_info", word, value]:
                self.remarks[word] = value
            case [] | ["obj_info", *_]:
                pass
            case ["comment", *rest]:
                self.comments.append(tuple(rest))
            case ["format", encoding, "1.0"] if (
                encoding in _BYTE_ORDERS and self.byte_order is None
            ):
                self.byte_order = _BYTE_ORDERS[encoding]
            case ["element", name, count] if re.fullmatch(r"[0-9]{1,18}", count):
                self._element(number, name, int(count))
            case ["property", "list", count_type, value_type, name]:
                self._property(number, name, value_type, count_type)
            case ["property", value_type, name]:
                self._property(number, name, value_type, None)
            case [word, *_] if word not in _KEYWORDS:
                text = " ".join(words)[:60]
                self.warnings.append(f"line {number} of the header has no keyword: {text!r}")
            case _:
                raise self._wrong(number, f"cannot make sense of {' '.join(words)[:60]!r}")

    def make_header(self, body_start: int, body_line: int) -> Header:
        """Return the header, whose last line was taken."""
        if self.byte_order is None:
            raise InputError(f"{self.path}: the PLY header has no 'format' line", _EXPORT_AGAIN)
        elements = tuple(
            Element(name, self.counts[name], tuple(properties.values()))
            for name, properties in self.elements.items()
        )
        for element in elements:
            if element.count and not element.properties:
                problem = f"PLY element {element.name!r} has no properties"
                raise InputError(f"{self.path}: {problem}", _EXPORT_AGAIN)
        found = tuple(self.warnings), tuple(self.comments), self.remarks
        return Header(self.byte_order, elements, body_start, body_line, *found)

    def _element(self, number: int, name: str, count: int) -> None:
        if name in self.elements:
            raise self._wrong(number, f"a second element {name!r}")
        self.counts[name], self.elements[name] = count, {}

    def _property(self, number: int, name: str, value: str, count: str | None) -> None:
        if not self.elements:
            raise self._wrong(number, f"property {name!r} before any element")
        element = next(reversed(self.elements))
        properties = self.elements[element]
        for word in (value, count):
            if word is not None and word not in SCALAR_TYPES:
                raise self._wrong(number, f"property {name!r} of unknown type {word!r}")
        if name in properties:
            raise self._wrong(number, f"a second property {name!r} of element {element!r}")
        count_dtype = None if count is None else SCALAR_TYPES[count]
        if count_dtype is not None and count_dtype.startswith("f"):
            raise self._wrong(number, f"list {name!r} whose length is a {count}")
        properties[name] = Property(name, SCALAR_TYPES[value], count_dtype, number)

    def _wrong(self, number: int, problem: str) -> InputError:
        return InputError(f"{self.path}:{number}: PLY header: {problem}", _EXPORT_AGAIN)
