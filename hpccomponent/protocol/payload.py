"""How buffers lie one after the other in a memory file or a parcel: at multiples of 64 bytes.

Arrays are then views of what has arrived.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hpccomponent.errors import ProtocolError

__all__ = ["ALIGNMENT", "aligned", "check_payload", "cut_payload"]

ALIGNMENT = 64


def aligned(length: int) -> int:
    """Round a length in bytes up to the next multiple of the alignment."""
    return -(-length // ALIGNMENT) * ALIGNMENT


def check_payload(payload: memoryview, sizes: Sequence[int]) -> None:
    """Check that a payload is as long as buffers of these sizes are.

    Raises
    ------
    ProtocolError
        If it is shorter or longer.
    """
    expected = sum(map(aligned, sizes[:-1])) + sum(sizes[-1:])
    if payload.nbytes != expected:
        raise ProtocolError(f"{payload.nbytes} bytes came where {expected} were announced")


def cut_payload(payload: memoryview, sizes: Iterable[int]) -> list[memoryview]:
    """Cut a payload into buffers of these sizes, without copying.

    Parameters
    ----------
    sizes : iterable of int
        In bytes.

    Raises
    ------
    ProtocolError
        If the payload is too short.

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
