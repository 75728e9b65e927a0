from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.errors import ProtocolError, UsageError
from hpccomponent.protocol.blobs import check_blob, make_blob
from hpccomponent.protocol.codec import decode_values, encode_arguments, encode_values
from hpccomponent.protocol.frames import group_frames, split_buffers


@given(st.lists(st.binary(max_size=300), max_size=5), st.binary(max_size=50), st.integers(1, 100))
def test_a_blob_that_came_in_pieces_is_known_by_its_key(
    buffers: list[bytes], header: bytes, largest: int
) -> None:
    blob = make_blob(header, buffers)
    sizes = [len(buffer) for buffer in buffers]
    frames = split_buffers(buffers, largest)
    check_blob(blob.key, header, sizes, group_frames(frames, sizes))
    assert blob.size_bytes == len(header) + sum(sizes)
    for other in ([*buffers, b""], [*buffers, b"x"]):
        assert make_blob(header, other).key != blob.key
    with pytest.raises(ProtocolError, match="does not hold"):
        check_blob(blob.key, header + b"x", sizes, group_frames(frames, sizes))


def test_a_changed_value_is_noticed() -> None:
    values = np.arange(3000.0)
    blob = make_blob(*encode_values((values,)))
    assert blob.is_unchanged()
    values[7] = 0.0
    assert not blob.is_unchanged()


def test_among_arguments_a_blob_stands_by_its_key_and_comes_back_as_its_value() -> None:
    blob = make_blob(*encode_values((np.arange(3000.0),)))
    header, buffers, blobs = encode_arguments((1, (blob, [blob]), {"a": blob}))
    assert blobs == (blob,)
    assert not buffers
    received = decode_values(header, buffers, {blob.key: "the value"})
    assert received == (1, ("the value", ["the value"]), {"a": "the value"})
    with pytest.raises(ProtocolError, match="is not here"):
        decode_values(header, buffers)


def test_a_blob_within_a_blob_is_refused() -> None:
    blob = make_blob(*encode_values((1,)))
    with pytest.raises(UsageError, match="within another"):
        encode_values(((blob, 2),))
