from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hpccomponent.errors import ProtocolError, UsageError
from hpccomponent.protocol.codec import MAX_DEPTH, decode_values, encode_values

ARRAYS = hnp.arrays(
    dtype=st.sampled_from(["?", "i1", "<u2", ">i4", "<f4", ">f8", "<c16", "<f2"]),
    shape=hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=40),
    elements=None,
    fill=st.nothing(),
) | st.integers(0, 3000).map(lambda n: np.arange(3 * n, dtype=float).reshape(n, 3))
SCALARS = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary()
    | st.text(min_size=1200, max_size=1300) | st.binary(min_size=5000, max_size=5100)
)  # fmt: skip
VALUES = st.recursive(
    SCALARS | ARRAYS,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.lists(inner, max_size=4).map(tuple)
        | st.dictionaries(st.text(), inner, max_size=4)
    ),
    max_leaves=12,
)


def assert_same(one: object, other: object) -> None:
    """Compare type by type and bit by bit."""
    assert type(one) is type(other)
    if isinstance(one, np.ndarray):
        assert isinstance(other, np.ndarray)
        assert one.shape == other.shape
        assert one.dtype.newbyteorder("=") == other.dtype
        assert one.astype(other.dtype).tobytes() == other.tobytes()
    elif isinstance(one, (list, tuple)):
        assert isinstance(other, (list, tuple))
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif isinstance(one, dict):
        assert isinstance(other, dict)
        assert list(one) == list(other)
        for key, value in one.items():
            assert_same(value, other[key])
    elif isinstance(one, float):
        assert isinstance(other, float)
        assert np.float64(one).tobytes() == np.float64(other).tobytes()
    else:
        assert one == other


@pytest.mark.slow
@settings(max_examples=80, deadline=None)
@given(st.lists(VALUES, max_size=4).map(tuple))
def test_values_come_back_bit_by_bit(values: tuple[object, ...]) -> None:
    header, buffers = encode_values(values)
    assert_same(values, decode_values(header, [bytes(buffer) for buffer in buffers]))


@pytest.mark.parametrize("offset", range(9))
def test_received_arrays_are_aligned_and_read_only(offset: int) -> None:
    sent = np.arange(5000.0)
    header, (buffer,) = encode_values((sent,))
    frame = memoryview(bytearray(offset) + bytearray(buffer))[offset:]
    (received,) = decode_values(header, [frame])
    assert received.flags.aligned
    assert not received.flags.writeable
    assert received.tobytes() == sent.tobytes()


def test_large_arrays_are_not_copied() -> None:
    sent = np.arange(5000.0)
    header, (buffer,) = encode_values((sent,))
    assert np.shares_memory(np.frombuffer(buffer, dtype=np.uint8), sent)
    (received,) = decode_values(header, [buffer])
    assert np.shares_memory(received, sent)


def test_numpy_numbers_stay_numpy_numbers() -> None:
    header, buffers = encode_values((np.float32(1.5), np.int64(7), np.bool_(True)))
    received = decode_values(header, buffers)
    assert [type(value) for value in received] == [np.float32, np.int64, np.bool_]
    assert received == (1.5, 7, True)


def test_long_lists_of_numbers_keep_every_kind() -> None:
    for values in (
        [1, True, 0.5, -(2**63), 2**63 - 1], [2**63, 1], [-(2**70), 0.5], [None] * 3,
        [float("nan"), 2**64], [1, None], [1, "a", b"b"], [0.0, (1, 2)],
    ):  # fmt: skip
        header, buffers = encode_values((values,))
        assert_same((values,), decode_values(header, buffers))


def nested(depth: int) -> list[object]:
    return [] if depth == 0 else [nested(depth - 1)]


@pytest.mark.parametrize(
    ("value", "word"),
    [
        ({1, 2}, "set"),
        (object(), "object"),
        (np.array([None]), "dtype"),
        (np.array(["text"]), "dtype"),
        (np.ma.masked_array([1.0]), "MaskedArray"),
        ({1: "one"}, "key"),
        ("\ud800", "surrogate"),
        (nested(MAX_DEPTH + 2), "deep"),
        ([0.5] * 1_000_000, "ndarray"),
    ],
)
def test_what_cannot_travel_is_refused_with_a_reason(value: object, word: str) -> None:
    with pytest.raises(UsageError, match=word):
        encode_values((value,))


def array(*description: object) -> bytes:
    return msgspec.msgpack.encode([[2, *description]])


@pytest.mark.parametrize(
    "header",
    [
        b"",
        b"\xc1",
        msgspec.msgpack.encode(7),
        msgspec.msgpack.encode([[]]),
        msgspec.msgpack.encode([["tag"]]),
        msgspec.msgpack.encode([[99]]),
        msgspec.msgpack.encode([{1: 2}]),
        msgspec.msgpack.encode([msgspec.msgpack.Ext(5, b"")]),
        array("<f8", [1]),
        array("|O", [1], b"12345678"),
        array("<M8[s]", [1], b"12345678"),
        array("<f8", [2], b"12345678"),
        array("<f8", [-1, -1], b"12345678"),
        array("<f8", [2**62, 4], b""),
        array("<f8", [2**63, 0], b""),
        array("<f8", [1] * 100, b"12345678"),
        array("<f8", "1", b"12345678"),
        array("<f8", [1], 12345678),
        array("<f8", [0], None),
        msgspec.msgpack.encode([[3, "<f8", [1], b"12345678"]]),
        msgspec.msgpack.encode([[6, 5]]),
        b"\x91" * 3000 + b"\xc0",
    ],
)
def test_hostile_headers_are_refused(header: bytes) -> None:
    with pytest.raises(ProtocolError):
        decode_values(header, [])


def test_the_number_of_buffers_must_fit() -> None:
    header, buffers = encode_values((np.arange(5000.0),))
    with pytest.raises(ProtocolError, match="fewer"):
        decode_values(header, [])
    with pytest.raises(ProtocolError, match="more"):
        decode_values(header, [*buffers, b""])


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200), st.lists(st.binary(max_size=50), max_size=2))
def test_random_bytes_are_values_or_a_protocol_error(header: bytes, buffers: list[bytes]) -> None:
    try:
        decode_values(header, buffers)
    except ProtocolError:
        return


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_damaged_headers_are_values_or_a_protocol_error(data: st.DataObject) -> None:
    values = (np.arange(12.0).reshape(3, 4), {"a": [1, (2.0, "x")]}, 2**80, np.float32(1.0))
    header = bytearray(encode_values(values)[0])
    for _ in range(data.draw(st.integers(1, 4))):
        header[data.draw(st.integers(0, len(header) - 1))] = data.draw(st.integers(0, 255))
    try:
        decode_values(bytes(header), [])
    except ProtocolError:
        return
