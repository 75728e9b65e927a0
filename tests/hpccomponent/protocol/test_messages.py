from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.messages import (
    Announce,
    Batch,
    Call,
    Drain,
    Failure,
    Farewell,
    Fetch,
    Forget,
    Goodbye,
    Heartbeat,
    Lost,
    Need,
    Piece,
    Ping,
    Refused,
    Register,
    RegisterAgain,
    Registered,
    Release,
    Result,
    Results,
    Share,
    decode_component_message,
    decode_master_message,
    encode_message,
)

OF_MASTER = [
    Registered("s", 1.0, 60.0, 1 << 20),
    Refused("no"),
    RegisterAgain(),
    Ping("s", 3),
    Drain("s"),
    Farewell("s"),
    Batch("s", 1, [Call(7, "name", b"header", [1, 2], [b"k" * 16])]),
    Share("s", b"k" * 16, b"header", [3]),
    Forget("s", [b"k" * 16]),
    Fetch("s", 7, 2, 0, 100),
    Release("s", 2),
]
OF_COMPONENT = [
    Register(1, "1", "w", "i", "b", "n", 4, 1 << 40, 1 << 20),
    Results("s", 1, [Result(7, 0.5, b"h", [3])], False),
    Results("s", 1, [Result(8, 0.0, b"", [], Failure("E", "why", "do", "trace"))], True),
    Announce("s", 1, 2, [7, 8], 100, 1 << 30),
    Piece("s", 7),
    Lost("s", 1, "signal 9", True),
    Need("s", 1, [b"k" * 16]),
    Heartbeat("s", 5, 2, [1]),
    Goodbye("s", "told to"),
]


@pytest.mark.parametrize("message", OF_MASTER)
def test_messages_of_the_master_come_back(message: Ping) -> None:
    assert decode_master_message(encode_message(message)) == message
    with pytest.raises(ProtocolError):
        decode_component_message(encode_message(message))


@pytest.mark.parametrize("message", OF_COMPONENT)
def test_messages_of_a_component_come_back(message: Heartbeat) -> None:
    assert decode_component_message(encode_message(message)) == message
    with pytest.raises(ProtocolError):
        decode_master_message(encode_message(message))


@pytest.mark.parametrize(
    "fields",
    [
        {"type": "Heartbeat", "session": "s", "progress": -1, "last_batch": 0, "held": []},
        {"type": "Heartbeat", "session": "s", "progress": "1", "last_batch": 0, "held": []},
        {"type": "Heartbeat", "session": "", "progress": 1, "last_batch": 0, "held": []},
        {"type": "Heartbeat", "session": "s", "progress": 1, "last_batch": 0, "held": [], "x": 1},
        {"type": "Results", "session": "s", "batch": 1, "results": [[1]], "is_finished": True},
        {"type": "Need", "session": "s", "batch": 1, "keys": [b"short"]},
        {"type": "Need", "session": "s", "batch": 1, "keys": []},
        {"type": "Nonsense"},
        {},
    ],
)
def test_decoding_is_strict(fields: dict[str, object]) -> None:
    with pytest.raises(ProtocolError):
        decode_component_message(msgspec.msgpack.encode(fields))


def test_a_newer_registration_can_still_be_read_to_be_refused() -> None:
    fields = msgspec.to_builtins(OF_COMPONENT[0]) | {"protocol": 99, "feature": "new"}
    message = decode_component_message(msgspec.msgpack.encode(fields))
    assert isinstance(message, Register)
    assert message.protocol == 99


@given(st.binary(max_size=300))
def test_random_bytes_are_a_protocol_error(frame: bytes) -> None:
    with pytest.raises(ProtocolError):
        decode_component_message(frame)
    with pytest.raises(ProtocolError):
        decode_master_message(frame)
