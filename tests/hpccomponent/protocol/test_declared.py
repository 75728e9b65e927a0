from __future__ import annotations

import msgspec
import numpy as np
import pytest

from hpccomponent.errors import ProtocolError, UsageError
from hpccomponent.protocol.codec import (
    MAX_CONTAINERS,
    check_containers,
    decode_values,
    encode_values,
)
from hpccomponent.protocol.declared import (
    Declared,
    Each,
    EachOf,
    Either,
    Exactly,
    Fixed,
    Flag,
    Nothing,
    Number,
    Text,
    Where,
    Whole,
    check_result,
)
from hpccomponent.protocol.declared_arrays import Array

POINTS = np.zeros((4, 3))


@pytest.mark.parametrize(
    ("pattern", "fits", "misfits"),
    [
        (Nothing(), [None], [0, False]),
        (Flag(), [True], [1, None, np.True_]),
        (Whole(0, 9), [0, 9], [-1, 10, True, 1.0, 2**70]),
        (Number(0.0), [0.0, 1e300], [-1.0, np.nan, np.inf, 1]),
        (Text(3), ["abc"], ["abcd", b"abc"]),
        (Exactly(("a", 1)), [("a", 1)], [("a", 2), ["a", 1]]),
        (Array("<f8", "n", 3), [POINTS, POINTS[:0]], [POINTS[:, :2], POINTS.astype("<f4"), None]),
        (Array("<f8", 2), [np.ones(2)], [np.array([1, np.nan]), np.array([np.inf, 1])]),
        (
            Array("<f8", 2, low=-np.inf, finite=False),
            [np.array([np.inf, -np.inf])],
            [np.array([np.nan, 1.0])],
        ),
        (Array("<i8", "n", low=0, high=5), [np.arange(6)], [np.arange(7), np.array([-1])]),
        (
            Array("<i8", "n", rises=True),
            [np.array([1, 2, 5]), np.array([], np.int64)],
            [np.array([1, 1]), np.array([2, 1])],
        ),
        (
            Array("<i8", "n", low=0, total=(2, 3)),
            [np.array([1, 1]), np.array([3])],
            [np.array([1]), np.array([2, 2]), np.zeros(0, np.int64), np.full(4, 2**62)],
        ),
        (
            Array("<f8", "n", 3, low=np.zeros(3), high=np.array([1.0, 2.0, 3.0])),
            [np.array([[1.0, 2.0, 3.0]]), POINTS],
            [np.array([[1.0, 2.0, 4.0]]), np.array([[1.0, -1.0, 0.0]])],
        ),
        (
            Array("<i8", 3, low=np.arange(3), high=np.arange(3)),
            [np.arange(3)],
            [np.arange(1, 4), np.array([0, 2, 1])],
        ),
        (
            Fixed(Array("<i8", "n"), Array("<i8", "n+1")),
            [(np.arange(2), np.arange(3))],
            [(np.arange(2), np.arange(2)), (np.arange(2),), [np.arange(2), np.arange(3)]],
        ),
        (Each(Whole(), 2), [[1, 2]], [[1], [1, "2"], (1, 2)]),
        (EachOf([Whole(), Flag()]), [[1, True]], [[1, 1], [1]]),
        (Either(Nothing(), Whole()), [None, 3], ["3"]),
        (Where(Whole(), lambda n: n % 2 == 0, "it is even"), [4], [3, None]),
    ],
)
def test_what_fits_a_pattern_passes_and_nothing_else(
    pattern: Declared, fits: list[object], misfits: list[object]
) -> None:
    for value in fits:
        check_result(pattern, value)
    for value in misfits:
        with pytest.raises(ProtocolError, match="the result"):
            check_result(pattern, value)


def test_an_int_too_long_to_be_printed_does_not_travel() -> None:
    (value,) = decode_values(*encode_values((10**2400,)))
    assert value == 10**2400
    with pytest.raises(UsageError, match="bytes"):
        encode_values((1 << 10_000,))
    with pytest.raises(ProtocolError, match="1024"):
        decode_values(msgspec.msgpack.encode([[6, b"\x01" * 1025]]), [])


def test_long_lists_of_numbers_are_no_containers() -> None:
    check_containers(msgspec.msgpack.encode(np.random.default_rng(1).random(400_000).tolist()))
    lists: list[object] = [[] for _ in range(MAX_CONTAINERS + 1)]
    with pytest.raises(ProtocolError, match="lists"):
        check_containers(msgspec.msgpack.encode(lists))
