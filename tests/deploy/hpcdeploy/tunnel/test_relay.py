"""Connections handed on, over real sockets."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from hpcdeploy.tunnel.relay import Pair, splice

LARGE = 1 << 24
"""More bytes than any socket holds."""


@pytest.fixture
def ends() -> Iterator[list[socket.socket]]:
    """Yield two connections: the far end and the near end of one, and of the other."""
    with ExitStack() as closer:
        made = [closer.enter_context(end) for _ in range(2) for end in socket.socketpair()]
        yield made


async def open_near(ends: list[socket.socket]) -> tuple[Pair, Pair]:
    return (
        await asyncio.open_connection(sock=ends[1]),
        await asyncio.open_connection(sock=ends[3]),
    )


def test_all_is_handed_on_before_the_other_end_is_closed(ends: list[socket.socket]) -> None:
    sent = bytes(range(256)) * (LARGE >> 8)

    async def hand_on() -> bytes:
        splicing = asyncio.ensure_future(splice(*await open_near(ends)))
        _, source = await asyncio.open_connection(sock=ends[0])
        reader, sink = await asyncio.open_connection(sock=ends[2])
        source.write(sent)
        source.close()
        received = await reader.read()
        await splicing
        sink.close()
        await asyncio.gather(source.wait_closed(), sink.wait_closed())
        return received

    assert asyncio.run(hand_on()) == sent


def test_cancelled_it_leaves_no_task_and_no_connection(ends: list[socket.socket]) -> None:
    async def cancel() -> None:
        one, other = await open_near(ends)
        splicing = asyncio.ensure_future(splice(one, other))
        _, source = await asyncio.open_connection(sock=ends[0])
        source.write(bytes(LARGE))
        while not other[1].transport.get_write_buffer_size():  # its far end reads nothing
            await asyncio.sleep(0)
        splicing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await splicing
        source.transport.abort()
        assert asyncio.all_tasks() == {asyncio.current_task()}
        assert [end.fileno() for end in (ends[1], ends[3])] == [-1, -1]

    asyncio.run(cancel())


def test_cancelled_while_it_sends_the_rest_it_closes(ends: list[socket.socket]) -> None:
    async def cancel() -> None:
        one, other = await open_near(ends)
        splicing = asyncio.ensure_future(splice(one, other))
        _, source = await asyncio.open_connection(sock=ends[0])
        while not other[1].transport.get_write_buffer_size():
            source.write(bytes(1024))
            await asyncio.sleep(0)
        source.close()
        while not other[1].is_closing():
            await asyncio.sleep(0)
        assert not splicing.done()
        splicing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await splicing
        assert [end.fileno() for end in (ends[1], ends[3])] == [-1, -1]

    asyncio.run(cancel())
