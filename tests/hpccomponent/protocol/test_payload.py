from __future__ import annotations

import pytest

from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.payload import ALIGNMENT, check_payload, cut_payload


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
