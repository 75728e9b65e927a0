from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.frames import join_frames, split_buffers


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
