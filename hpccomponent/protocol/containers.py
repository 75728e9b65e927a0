"""How many lists and dicts a MessagePack text makes: known before any of them takes memory.

An empty list is one byte of the text and more than 60 in memory, twice: a header of the largest
size would take half a gigabyte. Whatever else a text holds takes a small multiple of its length.
"""

from __future__ import annotations

import struct

import numpy as np

from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.frames import Buffer

MAX_CONTAINERS = 1 << 18

_NO_PAYLOAD = {0xC0: 0, 0xC2: 0, 0xC3: 0, 0xCA: 4, 0xCB: 8, 0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8}
_FIXED = _NO_PAYLOAD | {0xD0: 1, 0xD1: 2, 0xD2: 4, 0xD3: 8}
_COUNTED = {0xC4: ">B", 0xC5: ">H", 0xC6: ">I", 0xD9: ">B", 0xDA: ">H", 0xDB: ">I"}
_MANY = {0xDC: 2, 0xDD: 4, 0xDE: 2, 0xDF: 4}  # arrays and maps, with their count


def check_containers(text: Buffer) -> None:
    r"""Raise ProtocolError for a text that holds more than `MAX_CONTAINERS` arrays and maps.

    Bytes that could begin one are counted first, which takes no time; only where these are too
    many, as in a long list of random numbers, the text is walked through. What is malformed as
    MessagePack is for the decoder to say.

    Examples
    --------
    >>> check_containers(bytes([0x93, 0x90, 0x80, 0x01]))
    >>> check_containers(bytes([0xDD, 0, 8, 0, 0]) + b"\x90" * (1 << 19))
    Traceback (most recent call last):
    hpccomponent.errors.ProtocolError: a header of values holds more than 262144 lists and dicts
    """
    if len(text) <= MAX_CONTAINERS:
        return
    raw = np.frombuffer(text, np.uint8)
    may_begin = (raw >= 0x80) & (raw <= 0x9F) | (raw >= 0xDC) & (raw <= 0xDF)
    if np.count_nonzero(may_begin) > MAX_CONTAINERS and _count(text) > MAX_CONTAINERS:
        raise ProtocolError(f"a header of values holds more than {MAX_CONTAINERS} lists and dicts")


def _count(text: Buffer) -> int:
    """Count the arrays and maps, up to one more than are allowed."""
    containers = place = 0
    end = len(text)
    while place < end and containers <= MAX_CONTAINERS:
        kind = text[place]
        place += 1
        if kind in _FIXED:
            place += _FIXED[kind]
        elif 0x80 <= kind <= 0x9F:
            containers += 1
        elif 0xA0 <= kind <= 0xBF:
            place += kind & 0x1F
        elif kind in _MANY:
            containers, place = containers + 1, place + _MANY[kind]
        elif kind in _COUNTED:
            form = _COUNTED[kind]
            size = struct.calcsize(form)
            if place + size > end:
                break
            place += size + int(struct.unpack_from(form, text, place)[0])
    return containers
