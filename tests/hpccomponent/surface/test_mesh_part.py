"""A part of a mesh travels as a tuple of arrays."""

import numpy as np

from hpccomponent.protocol.codec import decode_values, encode_values
from hpccomponent.surface.mesh_part import MeshPart


def test_a_part_comes_off_the_wire_as_it_went_on():
    part = MeshPart(
        np.array([5, 9]),
        np.array([False, True]),
        np.array([2, 0], np.int32),
        np.array([1, 0], np.int32),
        np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]),
        np.array([[0, 1, -1]], np.int32),
        np.array([7]),
        np.array([3], np.int32),
    )
    header, buffers = encode_values(part.to_values())
    (*there,) = decode_values(header, buffers)
    back = MeshPart.from_values(tuple(there))
    for sent, received in zip(part.to_values(), back.to_values(), strict=True):
        assert received.dtype == sent.dtype
        assert np.array_equal(received, sent)
