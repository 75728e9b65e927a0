from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.frames import (
    ALIGNMENT,
    check_payload,
    cut_payload,
    join_frames,
    split_buffers,
)


@given(st.lists(st.binary(max_size=100)), st.integers(1, 40))
def test_joining_undoes_splitting(buffers: list[bytes], largest: int) -> None:
    frames = split_buffers(buffers, largest)
    assert all(0 < len(frame) <= largest for frame in frames)
    joined = join_frames(frames, [len(buffer) for buffer in buffers])
    assert [bytes(buffer) for buffer in joined] == buffers


@given(st.lists(st.binary(max_size=10)), st.lists(st.integers(0, 20)))
def test_frames_that_do_not_add_up_are_refused(frames: list[bytes], sizes: list[int]) -> None:
    try:
        joined = join_frames(frames, sizes)
    except ProtocolError:
        return
    assert [len(buffer) for buffer in joined] == sizes
    assert b"".join(bytes(buffer) for buffer in joined) == b"".join(frames)


@pytest.mark.parametrize(("frames", "sizes"), [([b"ab"], [1]), ([b"a"], [2]), ([b"a", b"b"], [1])])
def test_too_many_and_too_few_are_told_apart_from_right(
    frames: list[bytes], sizes: list[int]
) -> None:
    with pytest.raises(ProtocolError):
        join_frames(frames, sizes)


def test_a_payload_that_is_too_short_is_a_protocol_error() -> None:
    with pytest.raises(ProtocolError, match="shorter"):
        cut_payload(memoryview(b"abc"), [4])


@pytest.mark.parametrize("sizes", [[], [0], [5], [5, 0], [0, 5], [64, 1], [1, 64, 0, 0, 70]])
def test_a_payload_is_as_long_as_its_buffers_say(sizes: list[int]) -> None:
    payload = bytearray()
    for size in sizes:
        payload += bytes(-len(payload) % ALIGNMENT)
        payload += bytes([size % 251]) * size
    check_payload(memoryview(payload), sizes)
    assert [bytes(b) for b in cut_payload(memoryview(payload), sizes)] == [
        bytes([size % 251]) * size for size in sizes
    ]
    with pytest.raises(ProtocolError, match="announced"):
        check_payload(memoryview(payload + b"x"), sizes)
