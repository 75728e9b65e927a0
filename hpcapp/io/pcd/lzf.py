"""LZF, the compression of binary_compressed PCD files.

References
----------
Marc Lehmann, liblzf, http://oldhome.schmorp.de/marc/liblzf.html
"""

from __future__ import annotations

MOST_EXPANSION = 88
"""Bytes that one compressed byte can stand for: three bytes repeat up to 264."""


def expand_lzf(packed: bytes, size: int) -> bytearray:
    """Expand a block of LZF that holds `size` bytes; raise ValueError where it is damaged.

    Notes
    -----
    A control byte below 32 announces so many bytes and one more, as they are. Others repeat what
    was there before: the upper three bits are the length less 2, 7 for more in the next byte; the
    lower five and the next byte are how far back it starts, less 1. What is repeated may reach
    into itself.

    Examples
    --------
    >>> expand_lzf(bytes([1, 97, 98, 64, 1]), 6)
    bytearray(b'ababab')
    """
    expanded = bytearray()
    at, end = 0, len(packed)
    while at < end and len(expanded) <= size:
        control = packed[at]
        at += 1
        if control < 32:
            expanded += packed[at : at + control + 1]
            at += control + 1
            continue
        if at + 1 + (control >= 224) > end:
            raise ValueError("it ends within a repetition")
        length = (control >> 5) + 2
        if control >= 224:
            length += packed[at]
            at += 1
        back = ((control & 31) << 8) + packed[at] + 1
        at += 1
        start = len(expanded) - back
        if start < 0:
            raise ValueError("it repeats what is in front of its start")
        repeated = expanded[start : start + length]
        if length > back:
            repeated = (repeated * (length // back + 1))[:length]
        expanded += repeated
    if at != end or len(expanded) != size:
        raise ValueError(f"it holds other than {size} bytes")
    return expanded
