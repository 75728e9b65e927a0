"""Buffers to ZeroMQ frames and back: no frame is larger than both ends agreed on.

libzmq drops the connection of a peer that sends a frame above ``MAXMSGSIZE``, without a word to
the sender; and heartbeats pass between frames only, so that frames must stay short on slow links.

In a memory file or a parcel buffers lie one after the other as a payload, at multiples of
`ALIGNMENT`: arrays are then views of what has arrived.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hpccomponent.errors import ProtocolError

Buffer = bytes | bytearray | memoryview

DEFAULT_RESULT_BYTES = 1 << 30
"""How large the encoded result of a task may be that declares nothing else."""

LARGEST_FRAME = 256 * 1024  # CURVE is two to three times as fast here as with frames of 8 MiB
SMALLEST_FRAME = 64 * 1024
ALIGNMENT = 64


def split_buffers(buffers: Sequence[Buffer], largest: int) -> list[memoryview]:
    """Cut buffers, without copying, into frames of at most `largest` bytes; an empty one into none.

    Examples
    --------
    >>> [bytes(frame) for frame in split_buffers([b"abcde", b"", b"f"], 2)]
    [b'ab', b'cd', b'e', b'f']
    """
    frames = []
    for buffer in buffers:
        view = memoryview(buffer)
        frames += [view[start : start + largest] for start in range(0, view.nbytes, largest)]
    return frames


def group_frames(frames: Sequence[Buffer], sizes: Sequence[int]) -> list[Sequence[Buffer]]:
    """Find the frames of each buffer that `split_buffers` cut, none of an empty one: no copies.

    Raise ProtocolError where the frames do not add up to buffers of these sizes.
    """
    groups: list[Sequence[Buffer]] = []
    start = 0
    for size in sizes:
        end, missing = start, size
        while missing > 0 and end < len(frames):
            missing -= len(frames[end])
            end += 1
        if missing:
            raise ProtocolError(f"frames do not add up to a buffer of {size} bytes")
        groups.append(frames[start:end])
        start = end
    if start != len(frames):
        raise ProtocolError("a message carries more frames than it announces")
    return groups


def join_frames(frames: Sequence[Buffer], sizes: Sequence[int]) -> list[Buffer]:
    """Undo `split_buffers`: one buffer per entry of `sizes`, copied only if it came in pieces.

    Errors are those of `group_frames`.

    Examples
    --------
    >>> [bytes(buffer) for buffer in join_frames([b"ab", b"cde"], [5, 0])]
    [b'abcde', b'']
    """
    groups = group_frames(frames, sizes)
    return [group[0] if len(group) == 1 else b"".join(group) for group in groups]


def aligned(length: int) -> int:
    """Round a length in bytes up to the next multiple of the alignment."""
    return -(-length // ALIGNMENT) * ALIGNMENT


def check_payload(payload: memoryview, sizes: Sequence[int]) -> None:
    """Raise ProtocolError where a payload is shorter or longer than buffers of these sizes are."""
    expected = sum(map(aligned, sizes[:-1])) + sum(sizes[-1:])
    if payload.nbytes != expected:
        raise ProtocolError(f"{payload.nbytes} bytes came where {expected} were announced")


def cut_payload(payload: memoryview, sizes: Iterable[int]) -> list[memoryview]:
    """Cut a payload into buffers of these sizes, in bytes, without copying.

    Raise ProtocolError where the payload is too short.

    Examples
    --------
    >>> [bytes(buffer) for buffer in cut_payload(memoryview(b"a" * 64 + b"bc"), [1, 2])]
    [b'a', b'bc']
    """
    buffers, start = [], 0
    for size in sizes:
        buffers.append(payload[start : start + size])
        if buffers[-1].nbytes != size:
            raise ProtocolError("a message is shorter than it announces")
        start += aligned(size)
    return buffers
