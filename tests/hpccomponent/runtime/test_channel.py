from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hpccomponent.protocol.frames import ALIGNMENT, cut_payload
from hpccomponent.runtime.channel import (
    INLINE_BYTES,
    PREFIX,
    Channel,
    ChannelClosedError,
)


@pytest.fixture
def ends() -> Iterator[tuple[Channel, Channel]]:
    one, two = (Channel(end) for end in socket.socketpair())
    yield one, two
    one.close()
    two.close()


@settings(
    max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.binary(max_size=200), st.lists(st.binary(max_size=9000), max_size=8))
def test_messages_come_back_inline_and_in_shared_memory(
    ends: tuple[Channel, Channel], control: bytes, buffers: list[bytes]
) -> None:
    sender, receiver = ends
    sender.send(control, [[buffer[:5], buffer[5:]] for buffer in buffers])
    received, payload = receiver.receive()
    assert received == control
    cut = cut_payload(payload, [len(buffer) for buffer in buffers])
    assert [bytes(buffer) for buffer in cut] == buffers


def test_large_messages_do_not_block_and_are_views_that_cannot_be_written(
    ends: tuple[Channel, Channel],
) -> None:
    sender, receiver = ends
    sent = np.arange(1_000_000.0)
    sender.send(b"control", [[b"x"], [sent.view(np.uint8).data]])  # nobody reads yet
    _, payload = receiver.receive()
    small, large = cut_payload(payload, [1, sent.nbytes])
    assert bytes(small) == b"x"
    assert large.readonly
    array = np.frombuffer(large)
    assert array.ctypes.data % ALIGNMENT == 0
    np.testing.assert_array_equal(array, sent)


def test_two_inline_messages_fit_into_the_socket(ends: tuple[Channel, Channel]) -> None:
    sender, receiver = ends
    for _ in range(2):
        sender.send(bytes(INLINE_BYTES), [])
    assert len(receiver.receive()[0]) == INLINE_BYTES


def test_many_pieces_are_written(ends: tuple[Channel, Channel]) -> None:
    sender, receiver = ends
    pieces = [os.urandom(40) for _ in range(3000)]
    sender.send(b"", [pieces])
    (joined,) = cut_payload(receiver.receive()[1], [40 * 3000])
    assert joined == b"".join(pieces)


def test_an_end_tells_whether_something_has_come(ends: tuple[Channel, Channel]) -> None:
    sender, receiver = ends
    assert not receiver.has_message(0.001)
    for buffers in ([], [[bytes(2 * INLINE_BYTES)]]):
        sender.send(b"control", buffers)
        assert receiver.has_message()
        receiver.receive()
        assert not receiver.has_message()
    sender.close()
    assert receiver.has_message()  # the end, for which nobody would have to wait


def test_a_closed_end_is_noticed_by_the_other(ends: tuple[Channel, Channel]) -> None:
    one, two = ends
    reader = threading.Thread(target=one.close)
    reader.start()
    with pytest.raises(ChannelClosedError):
        two.receive()
    reader.join()
    with pytest.raises(ChannelClosedError):
        two.send(b"", [])


def test_an_end_that_closes_within_a_message_is_noticed() -> None:
    ours, theirs = socket.socketpair()
    ours.sendall(PREFIX.pack(100, 100, False) + b"half of it")
    ours.close()
    channel = Channel(theirs)
    with pytest.raises(ChannelClosedError):
        channel.receive()
    channel.close()
