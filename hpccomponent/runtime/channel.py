"""The channel between a component and its worker: a socket pair, and shared memory beside it.

::

    component                                         worker
       │  prefix | control | buffers                    │    small: all of it in the socket
       │ ─────────────────────────────────────────────> │
       │  prefix, with the descriptor of a memory file  │    large: control and buffers in it
       │ ─────────────────────────────────────────────> │

Control is the message as it travels on the wire; buffers start at multiples of 64 bytes, so that
arrays are views of what arrived. A memory file is written once, mapped read-only by the other
end, and gone when the last view of it is.
"""

from __future__ import annotations

import mmap
import os
import select
import socket
import struct
import tempfile
from collections.abc import Sequence
from contextlib import closing

from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.frames import ALIGNMENT, Buffer, aligned

PREFIX = struct.Struct("=QQB")  # length of control, of all, and whether a memory file holds them
INLINE_BYTES = 32 * 1024  # two such messages fit into any system's socket buffer: no send blocks
MAX_BUFFERS_PER_CALL = 512  # below every system's IOV_MAX


class ChannelClosedError(ProtocolError):
    """The other end of a channel is gone."""


class MemoryFile:
    """A message in a memory file, to be sent any number of times; OSError as of `Channel.send`."""

    def __init__(self, control: Buffer, buffers: Sequence[Sequence[Buffer]]) -> None:
        pieces, total = _lay_out(control, buffers)
        self.prefix = PREFIX.pack(len(control), total, True)
        self.descriptor = _write_memory_file(pieces)

    def close(self) -> None:
        """Free the memory once nobody has it mapped."""
        os.close(self.descriptor)


class Channel:
    """One end of the channel: a connected, blocking AF_UNIX stream socket, which it closes."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def fileno(self) -> int:
        """Return the descriptor to be polled."""
        return self._end.fileno()

    def close(self) -> None:
        """Close this end; the other reads the end of the stream."""
        self._end.close()

    def send(self, control: Buffer, buffers: Sequence[Sequence[Buffer]]) -> None:
        """Send a message; each buffer may come in pieces, which are joined on the way.

        Raise ChannelClosedError where the other end is gone, OSError where memory is short for it.
        """
        pieces, total = _lay_out(control, buffers)
        if total > INLINE_BYTES:
            with closing(MemoryFile(control, buffers)) as file:
                self.send_file(file)
            return
        try:
            self._end.sendall(b"".join([PREFIX.pack(len(control), total, False), *pieces]))
        except (BrokenPipeError, ConnectionResetError) as error:
            raise ChannelClosedError("the other end of the channel is gone") from error

    def send_file(self, file: MemoryFile) -> None:
        """Send a message that lies in a memory file, without copying it.

        Raise ChannelClosedError where the other end is gone.
        """
        try:
            socket.send_fds(self._end, [file.prefix], [file.descriptor])
        except (BrokenPipeError, ConnectionResetError) as error:
            raise ChannelClosedError("the other end of the channel is gone") from error

    def has_message(self, wait_s: float = 0.0) -> bool:
        """Wait until something has come, or the other end is gone: `receive` would not wait."""
        poll = select.poll()
        poll.register(self._end, select.POLLIN)
        return bool(poll.poll(1000.0 * wait_s))

    def receive(self) -> tuple[memoryview, memoryview]:
        """Wait for a message; return it, and its buffers, to be cut by `cut_payload`.

        Raise ChannelClosedError where the other end is gone.
        """
        try:
            prefix, descriptors, _, _ = socket.recv_fds(self._end, PREFIX.size, 1)
            if len(prefix) != PREFIX.size:
                raise ChannelClosedError("the other end of the channel is gone")
            control_length, total, is_large = PREFIX.unpack(prefix)
            if is_large:
                content = _map_memory_file(descriptors[0], total)
            else:
                content = memoryview(self._receive_exactly(total))
        except ConnectionResetError as error:
            raise ChannelClosedError("the other end of the channel is gone") from error
        return content[:control_length], content[aligned(control_length) :]

    def _receive_exactly(self, count: int) -> bytearray:
        content = bytearray(count)
        view = memoryview(content)
        while view:
            received = self._end.recv_into(view)
            if not received:
                raise ChannelClosedError("the other end of the channel is gone")
            view = view[received:]
        return content


def _lay_out(control: Buffer, buffers: Sequence[Sequence[Buffer]]) -> tuple[list[Buffer], int]:
    """Return all pieces with the padding between them, and their length in bytes."""
    pieces: list[Buffer] = []
    total = 0
    for parts in ([control], *buffers):
        if total % ALIGNMENT:
            pieces.append(bytes(-total % ALIGNMENT))
            total += -total % ALIGNMENT
        for part in parts:
            pieces.append(part)
            total += len(part)
    return pieces, total


def _write_memory_file(pieces: list[Buffer]) -> int:
    descriptor = _open_memory_file()
    try:
        pending = [memoryview(piece) for piece in pieces if len(piece)]
        while pending:
            written = os.writev(descriptor, pending[:MAX_BUFFERS_PER_CALL])
            while written:
                first = pending[0]
                if written < first.nbytes:
                    pending[0] = first[written:]
                    break
                written -= first.nbytes
                pending.pop(0)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _open_memory_file() -> int:
    if hasattr(os, "memfd_create"):
        return os.memfd_create("hpc", os.MFD_CLOEXEC)
    with tempfile.TemporaryFile() as stream:  # unlinked, in memory where the system keeps it so
        return os.dup(stream.fileno())


def _map_memory_file(descriptor: int, total: int) -> memoryview:
    flags = mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0)
    try:
        return memoryview(mmap.mmap(descriptor, total, flags=flags, prot=mmap.PROT_READ))
    finally:
        os.close(descriptor)
