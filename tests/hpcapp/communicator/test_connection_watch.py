from __future__ import annotations

import pytest

from hpcapp.communicator.connection_watch import (
    MOST_ON_THE_WAY,
    PROBE_BYTES_PER_S,
    WatchedConnection,
    choose_to_end,
    wire_bytes,
)

HALF = MOST_ON_THE_WAY // 2


def connection(descriptor: int, on_the_way: int, key: str = "") -> WatchedConnection:
    made = WatchedConnection(descriptor, 0.0, 0, key)
    made.look(on_the_way, 0.0)
    return made


def choose(*connections: WatchedConnection) -> tuple[list[int], list[str]]:
    chosen, keys = choose_to_end(connections)
    return [one.descriptor for one in chosen], keys


def test_all_connections_of_a_key_that_has_too_much_on_the_way_are_ended() -> None:
    honest = [connection(number, HALF, f"key {number}") for number in range(10)]
    liar = [connection(20, HALF, "liar"), connection(21, HALF, "liar"), connection(22, 1, "liar")]
    assert choose(*honest) == ([], [])
    assert choose(*honest, *liar) == ([20, 21, 22], ["liar"])


def test_of_unknown_ones_only_the_worst_are_ended() -> None:
    unknown = [connection(number, 100) for number in range(10)]
    assert choose(*unknown, connection(20, HALF), connection(21, 2 * HALF)) == ([21], [])
    assert choose(*unknown, *[connection(30 + n, HALF) for n in range(3)]) == ([30, 31], [])


def test_what_was_taken_is_not_on_the_way_and_neither_are_probes() -> None:
    made = WatchedConnection(1, 0.0, 0)
    made.taken = 1000
    made.look(1000 + 10 * PROBE_BYTES_PER_S + 5, 10.0)
    assert made.on_the_way == 5


def test_silence_is_not_saved_up_for_a_flood() -> None:
    made = WatchedConnection(1, 0.0, 0)
    made.look(0, 1e6)
    made.look(HALF, 1e6)
    assert made.on_the_way == HALF


@pytest.mark.parametrize("size", [0, 1, 33, 34, 221, 222, 223, 224, 1000, 65_535, 300_000])
def test_a_frame_takes_as_much_as_a_box_around_it(size: int) -> None:
    body = len(b"\x07MESSAGE") + 8 + 16 + 1 + size  # name, nonce, code, flags
    assert wire_bytes(size) == body + (2 if body < 256 else 9)
