"""Sizes and durations as people write them, parsed once: one grammar for options and files."""

from __future__ import annotations

import re

_SIZE = re.compile(r"(\d{1,15}(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", re.IGNORECASE)
_DURATION = re.compile(r"(\d{1,15}(?:\.\d+)?)\s*([smhd])")
_SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}


def parse_size(size: int | str) -> int:
    """Return a size in bytes; ValueError where it is none.

    It is bytes, or a number with K, M, G or T for powers of 1024, with or without ``B`` or ``iB``.

    Examples
    --------
    >>> parse_size("1.5 GiB") == parse_size("1.5G") == 3 * 2**29
    True
    """
    if isinstance(size, int) and not isinstance(size, bool):
        return size
    match = _SIZE.fullmatch(str(size).strip())
    if match is None:
        raise ValueError("should be a size such as 512M or 2 GiB")
    return int(float(match[1]) * 1024.0 ** " KMGT".index(match[2].upper() or " "))


def parse_duration(text: object) -> float:
    """Return a duration in seconds, of a number and unit: ``90s``, ``15m``, ``2h``, ``1d``.

    Raise ValueError where it is none.

    Examples
    --------
    >>> parse_duration("1.5h")
    5400.0
    """
    match = _DURATION.fullmatch(str(text).strip())
    if match is None:
        raise ValueError("should be a duration such as 90s, 15m or 2h")
    seconds = float(match[1]) * _SECONDS[match[2]]
    if not seconds:
        raise ValueError("should be longer than nothing")
    return seconds


def write_duration(seconds: float) -> str:
    """Return a duration in its two largest units.

    Examples
    --------
    >>> write_duration(42.9), write_duration(245), write_duration(3900)
    ('42s', '4m05', '1h05')
    """
    minutes, rest = divmod(int(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60}h{minutes % 60:02}"
    return f"{minutes}m{rest:02}" if minutes else f"{rest}s"
