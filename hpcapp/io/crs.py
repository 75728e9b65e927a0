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
# Systems with x, y and z from the centre of the earth: all of that type in EPSG 12.029.
_FROM_CENTRE = frozenset((
    3822, 3887, 4000, 4039, 4073, 4079, 4328, 4330, 4331, 4332, 4333, 4334, 4335, 4336, 4337, 4338,
    4340, 4342, 4344, 4346, 4348, 4350, 4352, 4354, 4356, 4358, 4360, 4362, 4364, 4366, 4368, 4370,
    4372, 4374, 4376, 4378, 4380, 4382, 4384, 4385, 4387, 4389, 4465, 4468, 4473, 4479, 4481, 4556,
    4882, 4884, 4886, 4888, 4890, 4892, 4894, 4896, 4897, 4899, 4906, 4908, 4910, 4911, 4912, 4913,
    4914, 4915, 4916, 4917, 4918, 4919, 4920, 4922, 4924, 4926, 4928, 4930, 4932, 4934, 4936, 4938,
    4940, 4942, 4944, 4946, 4948, 4950, 4952, 4954, 4956, 4958, 4960, 4962, 4964, 4966, 4968, 4970,
    4972, 4974, 4976, 4978, 4980, 4982, 4984, 4986, 4988, 4990, 4992, 4994, 4996, 4998, 5011, 5244,
    5250, 5262, 5322, 5332, 5341, 5352, 5358, 5363, 5368, 5369, 5379, 5391, 5487, 5544, 5558, 5591,
    5828, 5884, 6133, 6309, 6317, 6320, 6323, 6363, 6666, 6704, 6781, 6934, 6978, 6981, 6985, 6988,
    7071, 7134, 7137, 7371, 7656, 7658, 7660, 7662, 7664, 7677, 7679, 7681, 7684, 7789, 7796, 7815,
    7842, 7879, 7884, 7914, 7916, 7918, 7920, 7922, 7924, 7926, 7928, 7930, 8084, 8227, 8230, 8233,
    8238, 8242, 8247, 8250, 8253, 8397, 8401, 8425, 8429, 8541, 8543, 8683, 8697, 8816, 8898, 8905,
    8915, 8917, 8919, 8921, 8923, 8925, 8927, 8929, 8931, 8933, 8935, 8937, 8939, 8941, 8943, 8945,
    8947, 9001, 9004, 9007, 9010, 9015, 9070, 9073, 9138, 9146, 9151, 9182, 9266, 9292, 9307, 9331,
    9378, 9468, 9545, 9694, 9700, 9753, 9775, 9780, 9892, 9988, 10176, 10282, 10297, 10303, 10308,
    10326, 10412, 10473, 10569, 10604, 10634, 10637, 10669, 10688, 10723, 10734, 10737, 10760,
    10779, 10783, 10789, 10798, 10805, 10829, 10873, 10890, 10908, 10939, 10950, 10954, 10957,
    10966, 11041, 20039, 20044,
))  # fmt: skip
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

    The directory has four 16-bit numbers a key, a header of four before; keys refer to the texts,
    the ASCII parameters. A projected system that gives a code alone, of UTM on the usual datums,
    has metres.
    """
    keys, name = _read_keys(directory, texts)
    is_geographic, is_centred = keys.get(_MODEL) == 2, keys.get(_MODEL) == 3
    code = keys.get(_GEOGRAPHIC_CODE if is_geographic or is_centred else _PROJECTED_CODE, 0)
    code = 0 if is_centred and code not in _FROM_CENTRE else code  # it may be that of the datum
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


def is_geocentric(text: str | None) -> bool:
    """Tell whether a system is said to have x, y and z from the centre of the earth.

    Examples
    --------
    >>> is_geocentric("EPSG:4978"), is_geocentric('GEOCCS["WGS 84"]'), is_geocentric("EPSG:4979")
    (True, True, False)
    """
    if text is None or parse_epsg(text) is not None:
        return text is not None and parse_epsg(text) in _FROM_CENTRE
    system = _find_first(_parse_tree(text), (*_PROJECTED, *_GEOCENTRIC, *_GEOGRAPHIC))
    is_named = system is not None and system.keyword in _GEOCENTRIC
    return is_named and parse_wkt(text).unit != "degree"  # GEODCRS may have angles


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
