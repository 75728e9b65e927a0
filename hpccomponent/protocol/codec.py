"""Values to bytes and back, without pickle: a small header, and raw buffers for what is large.

A value is an ndarray of numbers, an int, float, bool, str, bytes or None, or a tuple, list,
string-keyed dict or record (see `records`) of these. The header is MessagePack; what MessagePack
lacks is an array whose first entry is a tag. Small arrays travel in the header, large ones as
buffers of their own, in the order in which the header names them, so that no two values can share
one. Among the arguments of a task a blob stands by its key.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from hpccomponent.errors import ProtocolError, UsageError
from hpccomponent.protocol.blobs import Blob
from hpccomponent.protocol.frames import Buffer
from hpccomponent.protocol.records import find_record, make_record

TUPLE, LIST, ARRAY, SCALAR, TEXT, BYTES, BIG, BLOB, RECORD = range(9)
EMBEDDED_BYTES = 4096  # below this an own frame costs more than a copy into the header
MAX_HEADER_BYTES = 4 * 1024 * 1024
MAX_DEPTH = 50
MAX_AXES = 32
MAX_CONTAINERS = 1 << 18
MAX_INTEGER_BYTES = 1024  # of an int: its digits can still be printed
DTYPES = frozenset(
    ["|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8",
     "<c8", "<c16"]
)  # fmt: skip
PLAIN = frozenset([type(None), bool, float])
NUMBERS = frozenset([bool, float, int])
SIMPLE = PLAIN | {int, bytes, str}  # as MessagePack has them
_ALLOWED = (
    "pass ndarrays of numbers, int, float, bool, str, bytes, None, "
    "or tuples, lists, string-keyed dicts and records of these"
)
NO_BLOBS: Mapping[bytes, object] = MappingProxyType({})

Packed: TypeAlias = "bool | int | float | str | bytes | list[Packed] | dict[str, Packed] | None"
"""A value in the header."""

_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(strict=True).decode


class _Attachments:
    """What goes beside the header: large buffers, and the blobs that it names."""

    __slots__ = ("blobs", "buffers")

    def __init__(self) -> None:
        self.buffers: list[Buffer] = []
        self.blobs: dict[bytes, Blob] = {}


class _Supply:
    """What came beside the header."""

    __slots__ = ("_blobs", "_buffers")

    def __init__(self, buffers: Sequence[Buffer], blobs: Mapping[bytes, object]) -> None:
        self._buffers = iter(buffers)
        self._blobs = blobs

    def take(self) -> Buffer:
        buffer = next(self._buffers, None)
        if buffer is None:
            raise ProtocolError("a message carries fewer buffers than its header names")
        return buffer

    def look_up(self, key: bytes) -> object:
        try:
            return self._blobs[key]
        except KeyError:
            raise ProtocolError(f"blob {key.hex()} is not here") from None

    def is_used_up(self) -> bool:
        return next(self._buffers, None) is None


def encode_values(values: tuple[object, ...]) -> tuple[bytes, list[Buffer]]:
    """Encode a tuple of values, the arguments or the result of a task.

    Return a header of at most 4 MiB, and the large parts, little-endian, in the order in which the
    header names them. Large contiguous arrays are not copied and must not change until the buffers
    have been used. Raise UsageError where a value is of no type that may travel, or nested too
    deeply (or contains itself), or the header grows too large.
    """
    parts = _Attachments()
    header = _encode_header(values, parts)
    if parts.blobs:
        raise UsageError(
            "a shared value stands within another one, or within a result",
            "pass it among the arguments of a task, by itself or in tuples, lists and dicts",
        )
    return header, parts.buffers


def encode_arguments(values: tuple[object, ...]) -> tuple[bytes, list[Buffer], tuple[Blob, ...]]:
    """Encode the arguments of a task, among which blobs may stand, as `encode_values` does.

    Return the blobs, too: what the header names by its key, each once.
    """
    parts = _Attachments()
    header = _encode_header(values, parts)
    return header, parts.buffers, tuple(parts.blobs.values())


def _encode_header(values: tuple[object, ...], parts: _Attachments) -> bytes:
    try:
        header = _encode([_pack(value, parts, 0) for value in values])
    except UnicodeEncodeError as error:
        raise UsageError("a str holds half a surrogate pair", "pass it as bytes") from error
    if len(header) > MAX_HEADER_BYTES:
        raise UsageError(
            f"the small values of one task take {len(header)} bytes, more than {MAX_HEADER_BYTES}",
            "pass long lists of numbers as one ndarray",
        )
    return header


def decode_values(
    header: Buffer, buffers: Sequence[Buffer], blobs: Mapping[bytes, object] = NO_BLOBS
) -> tuple[Any, ...]:
    """Decode what `encode_values` made; trusts neither the header nor the buffers.

    Each buffer is in one piece; `blobs` are decoded values, by their keys. Arrays are aligned,
    C-contiguous and read-only; large ones are views of their buffers. Raise ProtocolError where
    header and buffers do not describe such values.
    """
    if len(header) > MAX_HEADER_BYTES:
        raise ProtocolError(f"a header of values has more than {MAX_HEADER_BYTES} bytes")
    check_containers(header)
    try:
        packed = _decode(header)
        if type(packed) is not list:
            raise ProtocolError("a header of values is not an array")
        supply = _Supply(buffers, blobs)
        values = tuple([_unpack(entry, supply, 0) for entry in packed])
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise ProtocolError(f"a header of values cannot be decoded: {error}") from error
    if not supply.is_used_up():
        raise ProtocolError("a message carries more buffers than its header names")
    return values


def _pack(value: Any, parts: _Attachments, depth: int) -> Packed:
    kind = type(value)
    if kind in PLAIN or (kind is int and -(2**63) <= value < 2**63):
        return value  # type: ignore[no-any-return]
    if depth > MAX_DEPTH:
        raise UsageError(f"values are nested more than {MAX_DEPTH} deep", _ALLOWED)
    packer = _PACKERS.get(kind) or (_pack_scalar if isinstance(value, np.generic) else _pack_record)
    return packer(value, parts, depth)


def _pack_big(value: int, _parts: _Attachments, _depth: int) -> list[Packed]:
    length = value.bit_length() // 8 + 1
    if length > MAX_INTEGER_BYTES:
        raise UsageError(
            f"an int of {length} bytes cannot travel to or from a worker",
            f"pass ints of at most {MAX_INTEGER_BYTES} bytes, larger ones as bytes",
        )
    return [BIG, value.to_bytes(length, "little", signed=True)]


def _pack_array(value: NDArray[np.generic], parts: _Attachments, _depth: int) -> list[Packed]:
    code = value.dtype.newbyteorder("<").str
    if code not in DTYPES:
        raise UsageError(
            f"an array of dtype {value.dtype} cannot travel to a worker",
            "pass booleans, integers, floats or complex numbers of a standard size",
        )
    array = np.asarray(value, dtype=code, order="C")
    if array.nbytes <= EMBEDDED_BYTES:
        return [ARRAY, code, list(value.shape), array.tobytes()]
    parts.buffers.append(array.reshape(-1).view(np.uint8).data)
    return [ARRAY, code, list(value.shape), None]


def _pack_scalar(value: np.generic, parts: _Attachments, depth: int) -> list[Packed]:
    return [SCALAR, *_pack_array(np.asarray(value), parts, depth)[1:]]


def _pack_text(value: str, parts: _Attachments, _depth: int) -> Packed:
    if len(value) <= EMBEDDED_BYTES // 4:
        return value
    parts.buffers.append(value.encode())
    return [TEXT]


def _pack_bytes(value: bytes, parts: _Attachments, _depth: int) -> Packed:
    if len(value) <= EMBEDDED_BYTES:
        return value
    parts.buffers.append(value)
    return [BYTES]


def _pack_tuple(value: tuple[object, ...], parts: _Attachments, depth: int) -> list[Packed]:
    return [TUPLE, *[_pack(entry, parts, depth + 1) for entry in value]]


def _pack_list(value: list[Any], parts: _Attachments, depth: int) -> list[Packed]:
    kinds = set(map(type, value))  # long lists of numbers are common
    if kinds <= PLAIN or (kinds <= NUMBERS and min(value) >= -(2**63) and max(value) < 2**63):
        return [LIST, *value]
    return [LIST, *[_pack(entry, parts, depth + 1) for entry in value]]


def _pack_dict(value: dict[Any, object], parts: _Attachments, depth: int) -> dict[str, Packed]:
    for key in value:
        if type(key) is not str:
            raise UsageError(f"a dict has the key {key!r}", "only strings may be keys")
    return {key: _pack(entry, parts, depth + 1) for key, entry in value.items()}


def _pack_record(value: object, parts: _Attachments, depth: int) -> list[Packed]:
    kind = type(value)
    entry = find_record(kind)
    if entry is None:
        name = f"{kind.__module__}.{kind.__qualname__}"
        raise UsageError(f"a value of type {name} cannot travel to a worker", _ALLOWED)
    fields = {name: _pack(getattr(value, name), parts, depth + 1) for name in entry.fields}
    return [RECORD, entry.name, fields]


def _pack_blob(value: Blob, parts: _Attachments, _depth: int) -> list[Packed]:
    parts.blobs[value.key] = value
    return [BLOB, value.key]


_PACKERS: dict[type, Callable[[Any, _Attachments, int], Packed]] = {
    int: _pack_big,
    np.ndarray: _pack_array,
    np.memmap: _pack_array,
    str: _pack_text,
    bytes: _pack_bytes,
    tuple: _pack_tuple,
    list: _pack_list,
    dict: _pack_dict,
    Blob: _pack_blob,
}


def _unpack(packed: Packed, supply: _Supply, depth: int) -> object:
    kind = type(packed)
    if kind in SIMPLE:
        return packed
    if depth > MAX_DEPTH:
        raise ProtocolError(f"received values are nested more than {MAX_DEPTH} deep")
    if isinstance(packed, dict):
        return _unpack_dict(packed, supply, depth)
    if not isinstance(packed, list) or not packed or type(tag := packed[0]) is not int:
        raise ProtocolError(f"a header holds a {kind.__name__} without a tag")
    entries = packed[1:]
    unpacker, kinds = _UNPACKERS.get(tag, (None, None))
    if unpacker is None or (kinds is not None and kinds != list(map(type, entries))):
        raise ProtocolError(f"a header holds an entry with the unknown tag {tag}")
    return unpacker(entries, supply, depth)


def _unpack_dict(packed: dict[str, Packed], supply: _Supply, depth: int) -> dict[str, object]:
    if any(type(key) is not str for key in packed):
        raise ProtocolError("a received dict has a key that is not a string")
    return {key: _unpack(entry, supply, depth + 1) for key, entry in packed.items()}


def _unpack_tuple(entries: list[Packed], supply: _Supply, depth: int) -> tuple[object, ...]:
    return tuple(_unpack_list(entries, supply, depth))


def _unpack_list(entries: list[Packed], supply: _Supply, depth: int) -> Sequence[object]:
    if SIMPLE.issuperset(map(type, entries)):
        return entries
    return [_unpack(entry, supply, depth + 1) for entry in entries]


def _unpack_array(entries: list[Any], supply: _Supply, _depth: int) -> NDArray[np.generic]:
    if len(entries) != 3:
        raise ProtocolError("an array is not described by dtype, shape and bytes")
    code, shape, embedded = entries
    _check_array(code, shape)
    buffer = supply.take() if embedded is None else embedded
    if type(buffer) not in (bytes, bytearray, memoryview):
        raise ProtocolError("the bytes of an array are not bytes")
    dtype = np.dtype(code)
    if math.prod(shape) * dtype.itemsize != memoryview(buffer).nbytes:
        raise ProtocolError(f"an array of shape {shape} and dtype {code} has the wrong size")
    try:
        array = np.frombuffer(buffer, dtype=dtype).reshape(shape)
    except ValueError as error:  # more axes than numpy allows, or an extent beyond its index type
        raise ProtocolError(f"an array has the shape {shape}: {error}") from error
    if not array.flags.aligned:
        array = array.copy()
    if sys.byteorder == "big":
        array = array.astype(dtype.newbyteorder("="))
    array.flags.writeable = False
    return array


def _check_array(code: object, shape: object) -> None:
    if type(code) is not str or code not in DTYPES:
        shown = code[:20] if type(code) is str else type(code).__name__
        raise ProtocolError(f"an array has the dtype {shown!r}, which may not travel")
    if type(shape) is not list or len(shape) > MAX_AXES:
        raise ProtocolError(f"an array has no shape, or one of more than {MAX_AXES} axes")
    if not all(type(n) is int and n >= 0 for n in shape):
        raise ProtocolError("an array has a shape with entries that are no extents")


def _unpack_scalar(entries: list[Any], supply: _Supply, depth: int) -> Any:
    array = _unpack_array(entries, supply, depth)
    if array.shape:
        raise ProtocolError(f"a number has the shape {list(array.shape)!r}")
    return array[()]


def _unpack_big(entries: list[bytes], _supply: _Supply, _depth: int) -> int:
    if len(entries[0]) > MAX_INTEGER_BYTES:
        raise ProtocolError(f"a received int has more than {MAX_INTEGER_BYTES} bytes")
    return int.from_bytes(entries[0], "little", signed=True)


def _unpack_record(entries: list[Any], supply: _Supply, depth: int) -> object:
    name, fields = entries
    values: Any = _unpack(fields, supply, depth + 1)
    return make_record(name, values)


_UNPACKERS: dict[int, tuple[Callable[[Any, _Supply, int], object], list[type] | None]] = {
    TUPLE: (_unpack_tuple, None),
    LIST: (_unpack_list, None),
    ARRAY: (_unpack_array, None),
    SCALAR: (_unpack_scalar, None),
    TEXT: (lambda _, supply, __: bytes(supply.take()).decode(), []),
    BYTES: (lambda _, supply, __: bytes(supply.take()), []),
    BIG: (_unpack_big, [bytes]),
    BLOB: (lambda entries, supply, _: supply.look_up(entries[0]), [bytes]),
    RECORD: (_unpack_record, [str, dict]),
}
"""By its tag, what reads an entry, and the types of what follows the tag; None where it looks."""

_NO_PAYLOAD = {0xC0: 0, 0xC2: 0, 0xC3: 0, 0xCA: 4, 0xCB: 8, 0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8}
_FIXED = _NO_PAYLOAD | {0xD0: 1, 0xD1: 2, 0xD2: 4, 0xD3: 8}
_COUNTED = {0xC4: ">B", 0xC5: ">H", 0xC6: ">I", 0xD9: ">B", 0xDA: ">H", 0xDB: ">I"}
_MANY = {0xDC: 2, 0xDD: 4, 0xDE: 2, 0xDF: 4}  # arrays and maps, with their count


def check_containers(text: Buffer) -> None:
    r"""Raise ProtocolError for a text that holds more than `MAX_CONTAINERS` arrays and maps.

    An empty list is one byte of the text and more than 60 in memory, twice: a header of the largest
    size would take half a gigabyte. Whatever else it holds takes a small multiple of its length.
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
