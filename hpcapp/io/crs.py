"""Coordinate reference systems: their name and their unit, out of WKT or GeoTIFF keys.

No projection is computed; what a scan's numbers mean must be known all the same.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping

from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True)
class Crs:
    """A coordinate reference system.

    Parameters
    ----------
    text : str or None
        WKT, ``EPSG:`` and a code, or a mere name; None where a file states a unit only.
    unit : str or None
        Of the horizontal coordinates: ``m``, ``ft``, ``US ft``, ``mm``, ``cm``, ``km``,
        ``degree``; None where it is not stated.
    height_unit : str or None
        Of the heights, where it is stated of them alone.
    """

    text: str | None
    unit: str | None
    height_unit: str | None = None

    @property
    def height_scale(self) -> float:
        """What makes heights as long as the other coordinates: 1 where nothing else is known."""
        if self.unit not in METRES or self.height_unit not in METRES:
            return 1.0
        scale = METRES[self.height_unit] / METRES[self.unit]
        return scale if abs(scale - 1.0) > _SAME_FEET else 1.0

    @property
    def stated(self) -> dict[str, str]:
        """What is known, by name, on one line each; the heights' unit where it is another one."""
        height_unit = None if self.height_scale == 1.0 else self.height_unit
        known = {"unit": self.unit, "height_unit": height_unit, "crs": self.text}
        lines = {name: " ".join(value.split()) for name, value in known.items() if value}
        return {name: "".join(filter(str.isprintable, line)) for name, line in lines.items()}


UNKNOWN = Crs(None, None)


@dataclass(frozen=True, slots=True)
class _Node:
    keyword: str
    children: list[_Node | str]

    def nodes(self, *keywords: str) -> Iterator[_Node]:
        for child in self.children:
            if isinstance(child, _Node) and child.keyword in keywords:
                yield child


_TOKEN = re.compile(r'"((?:[^"]++|"")*+)"?|([^\s,\[\]()"]++)(\s*+[\[(])?|([\])])')
_PROJECTED = ("PROJCS", "PROJCRS", "PROJECTEDCRS", "LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")
_GEOCENTRIC = ("GEOCCS", "GEODCRS", "GEODETICCRS")
_VERTICAL = ("VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS")
_GEOGRAPHIC = ("GEOGCS", "GEOGCRS", "GEOGRAPHICCRS")
METRES = {
    "m": 1.0,
    "ft": 0.3048,
    "US ft": 1200 / 3937,
    "mm": 0.001,
    "cm": 0.01,
    "km": 1000.0,
}
"""How many of them a unit of length is."""

_SAME_FEET = 1e-5  # more than the two feet differ by
_SAME_FACTOR = 1e-7  # the two feet differ by 2e-6; factors are written with 8 digits and more

_MODEL, _CITATION, _GEOGRAPHIC_CODE, _GEOGRAPHIC_LENGTH = 1024, 1026, 2048, 2052
_PROJECTED_CODE, _PROJECTED_NAME, _PROJECTED_LENGTH = 3072, 3073, 3076
_VERTICAL_LENGTH = 4099
UNIT_CODES = {"m": 9001, "ft": 9002, "US ft": 9003, "km": 9036, "mm": 1025, "cm": 1033}
"""Codes of EPSG for units of length."""
_UNITS_BY_CODE = {code: unit for unit, code in UNIT_CODES.items()}
_ASCII = 34737
_STATED = range(1, 32767)  # codes: 0 is undefined, 32767 defined by other keys


def parse_wkt(text: str) -> Crs:
    """Find the unit of a coordinate reference system in WKT, of either version, perhaps damaged.

    Examples
    --------
    >>> parse_wkt('PROJCS["a",GEOGCS["b",UNIT["degree",0.017]],UNIT["foot",0.3048]]').unit
    'ft'
    """
    root = _parse_tree(text)
    system = _find_first(root, (*_PROJECTED, *_GEOCENTRIC, *_GEOGRAPHIC))
    if system is None:
        return Crs(text, None)
    if system.keyword in _GEOGRAPHIC:
        return Crs(text, "degree")
    vertical = _find_first(root, _VERTICAL)
    height_unit = None if vertical is None else _find_length(vertical)
    if any(any(holder.nodes("ANGLEUNIT")) for holder in (system, *system.nodes("AXIS"))):
        return Crs(text, "degree", height_unit)
    return Crs(text, _find_length(system), height_unit)


def parse_geokeys(directory: bytes, texts: bytes) -> Crs | None:
    """Find the code and the unit of a coordinate reference system in GeoTIFF keys, or None.

    Parameters
    ----------
    directory : bytes
        Of the keys: four 16-bit numbers each, a header of four before.
    texts : bytes
        The ASCII parameters that keys refer to.

    Notes
    -----
    A projected system that gives a code alone, of UTM on the usual datums, has metres.
    """
    keys, name = _read_keys(directory, texts)
    is_geographic = keys.get(_MODEL) == 2
    code = keys.get(_GEOGRAPHIC_CODE if is_geographic else _PROJECTED_CODE, 0)
    unit = "degree" if is_geographic else _find_key_length(keys)
    height_unit = _UNITS_BY_CODE.get(keys.get(_VERTICAL_LENGTH, 0))
    text = f"EPSG:{code}" if code in _STATED else name or None
    return Crs(text, unit, height_unit) if text or unit else None


def _find_key_length(keys: Mapping[int, int]) -> str | None:
    for key in (_PROJECTED_LENGTH, _GEOGRAPHIC_LENGTH):
        if keys.get(key) in _UNITS_BY_CODE:
            return _UNITS_BY_CODE[keys[key]]
    return "m" if keys.get(_MODEL) == 3 or _is_utm(keys.get(_PROJECTED_CODE, 0)) else None


def _read_keys(directory: bytes, texts: bytes) -> tuple[dict[int, int], str]:
    """Return the numbers that keys state, and the name of the system; empty without one."""
    shorts = struct.unpack(f"<{len(directory) // 2}H", directory[: len(directory) // 2 * 2])
    keys: dict[int, int] = {}
    name = ""
    for at in range(4, len(shorts) - 3, 4):
        key, place, count, value = shorts[at : at + 4]
        if place == 0:
            keys[key] = value
        elif place == _ASCII and key in (_CITATION, _PROJECTED_NAME) and not name:
            name = texts[value : value + count].decode("latin-1").strip("|\0 ")
    return keys, name


def parse_epsg(text: str) -> int | None:
    """Return the code of a text like ``EPSG:32632``, or None.

    Examples
    --------
    >>> parse_epsg("EPSG:32632"), parse_epsg("unknown")
    (32632, None)
    """
    match = re.fullmatch(r"EPSG:(\d{1,5})", text.strip(), re.IGNORECASE)
    return int(match[1]) if match and int(match[1]) in _STATED else None


def _is_utm(code: int) -> bool:
    zones = (32600, 32700, 26900, 25800)  # WGS 84 north and south, NAD83, ETRS89
    return any(zone < code <= zone + 60 for zone in zones)


def _parse_tree(text: str) -> _Node:
    """Parse brackets into a tree; what is not closed ends with the text."""
    root = _Node("", [])
    open_nodes = [root]
    for quoted, word, opening, closing in _TOKEN.findall(text):
        if opening:
            node = _Node(word.upper(), [])
            open_nodes[-1].children.append(node)
            open_nodes.append(node)
        elif closing:
            if len(open_nodes) > 1:
                open_nodes.pop()
        else:
            open_nodes[-1].children.append(quoted or word)
    return root


def _find_first(root: _Node, keywords: tuple[str, ...]) -> _Node | None:
    """Return the first node of these keywords, outer ones before what they hold."""
    waiting: list[_Node] = [root]
    while waiting:
        node = waiting.pop()
        if node.keyword in keywords:
            return node
        waiting.extend(child for child in reversed(node.children) if isinstance(child, _Node))
    return None


def _find_length(system: _Node) -> str | None:
    """Return the unit of length of a system, or of the first of its axes that states one."""
    for holder in (system, *system.nodes("AXIS")):
        for unit in holder.nodes("UNIT", "LENGTHUNIT"):
            return _find_unit(unit)
    return None


def _find_unit(unit: _Node) -> str | None:
    """Return the unit of a factor; None where its name is that of another one."""
    try:
        factor = float(str(unit.children[1]))
    except (IndexError, ValueError):
        return None
    for name, metres in METRES.items():
        if abs(factor - metres) <= _SAME_FACTOR * metres:
            is_foot = any(word in str(unit.children[0]).lower() for word in ("foot", "feet"))
            return None if is_foot and not name.endswith("ft") else name
    return None
