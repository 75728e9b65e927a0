"""Numbers as people read them: on the terminal, in the words of a report, on pages.

``pages/static/numbers.js`` does the same for what a page computes itself.
"""

from __future__ import annotations

from math import floor, isfinite, log10

_NAMES = {
    "boundaries": "borders",
    "boundary_edges": "edges at a border",
    "bytes_received": "bytes received",
    "cell_size": "cells of the points, edge",
    "closure": "why open or closed",
    "closure_certainty": "how sure that is",
    "coarsest_step": "largest cell, edge",
    "component_genus": "handles of each piece",
    "components": "pieces",
    "crumbs": "small pieces dropped",
    "edge_manifold": "manifold at edges",
    "farthest": "the rest is away up to",
    "fill_holes": "holes filled up to",
    "genus": "handles",
    "grid": "cells along the longest side",
    "handle_place": "one that is left lies at",
    "handle_width": "small handles, no wider than",
    "handles_cut": "small handles cut",
    "handles_left": "small handles left",
    "hollows_dropped": "small hollows dropped",
    "lam": "smoothing",
    "levels": "levels of detail",
    "patches": "cells that hold points",
    "pieces_dropped": "pieces not asked for, dropped",
    "points": "points used",
    "reach": "no point supports beyond",
    "refined_levels": "levels added for detail",
    "scan_lines": "scan lines: gap and step",
    "share": "supported by points",
    "small_pieces": "pieces that are small",
    "spacing": "spacing of the points",
    "spacing_range": "spacing, from and to",
    "step": "cell, edge",
    "sure": "sides that are sure",
    "trim": "cut off beyond",
    "turned": "turned around",
    "smoothed_depths": "depths in layers smoothed",
    "turned_normals": "inconsistent normals flipped",
    "unsupported": "supported by no point, were it closed",
    "vertex_manifold": "manifold at vertices",
}
"""What people call otherwise than a report does."""
_DIGITS = 3
_LEAST, _MOST = 1e-4, 1e7  # beyond them the exponent is written


def say_count(number: int, one: str, many: str = "") -> str:
    """Return how many of something there are; by default many of it get an s.

    Examples
    --------
    >>> say_count(80476, "vertex", "vertices")
    '80,476 vertices'
    >>> say_count(1, "piece")
    '1 piece'
    """
    return f"{number:,} {one if number == 1 else many or one + 's'}"


def say_name(name: str) -> str:
    """Return what people call an entry of a report.

    Examples
    --------
    >>> say_name("components"), say_name("edge_count")
    ('pieces', 'edge count')
    """
    return _NAMES.get(name, name.replace("_", " "))


def say_number(number: float, unit: str = "") -> str:
    """Return a measured number with three digits, and its unit, if that is known.

    Examples
    --------
    >>> say_number(1234.5, "m"), say_number(0.00137079), say_number(2.0, "s")
    ('1,230 m', '0.00137', '2.00 s')
    >>> say_number(1.5e-7), say_number(0.0)
    ('1.50e-07', '0')
    """
    behind = f" {unit}" if unit else ""
    if number == 0.0 or not isfinite(number):
        return f"{number:g}{behind}"
    if not _LEAST <= abs(number) < _MOST:
        return f"{number:.{_DIGITS - 1}e}{behind}"
    rounded = float(f"{number:.{_DIGITS}g}")
    decimals = max(0, _DIGITS - 1 - floor(log10(abs(rounded))))
    return f"{rounded:,.{decimals}f}{behind}"


def say_value(value: object) -> str:
    """Return a value of a report as a page shows it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    return say_number(value) if isinstance(value, float) else str(value)


def say_share(share: float) -> str:
    """Return a share from 0 to 1 in per cent, of which only all and nothing are 100 and 0.

    Examples
    --------
    >>> say_share(0.98349), say_share(1.0), say_share(0.99997), say_share(0.00001)
    ('98.3 %', '100 %', '99.9 %', '0.1 %')
    """
    if share in (0.0, 1.0):
        return f"{100 * share:.0f} %"
    return f"{min(max(100.0 * share, 0.1), 99.9):.1f} %"


def round_ticks(end: float, most: int = 5) -> list[float]:
    """Return round numbers from 0 to an end above 0: multiples of 1, 2 or 5 times a power of ten.

    There are so many steps at most.

    Examples
    --------
    >>> round_ticks(4.7)
    [0.0, 1.0, 2.0, 3.0, 4.0]
    >>> round_ticks(0.31)
    [0.0, 0.1, 0.2, 0.3]
    """
    power = 10.0 ** floor(log10(end / most))
    step = next(factor * power for factor in (1, 2, 5, 10, 20) if end <= factor * power * most)
    decimals = max(0, -floor(log10(step)))
    return [round(number * step, decimals) for number in range(int(end / step * (1 + 1e-9)) + 1)]
