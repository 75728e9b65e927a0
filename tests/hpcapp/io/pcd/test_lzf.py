"""What was compressed comes back, and what was not is refused."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpcapp.io.pcd.lzf import MOST_EXPANSION, expand_lzf


@pytest.mark.parametrize(
    ("packed", "expanded"),
    [
        (b"", b""),
        (b"\x02abc", b"abc"),
        (b"\x1f" + b"0123456789" * 3 + b"xy", b"0123456789" * 3 + b"xy"),
        (b"\x03abcd\x40\x03", b"abcdabcd"),
        (b"\x03abcd\x60\x01", b"abcdcdcdc"),  # it reaches into itself
        (b"\x00a\xe0\xff\x00", b"a" * 265),
        (b"\x00a" + b"\xe0\xff\x00" * 10 + b"\x22\x00", b"a" * 2641 + b"aaa"),
    ],
)
def test_blocks_are_expanded(packed: bytes, expanded: bytes) -> None:
    assert expand_lzf(packed, len(expanded)) == expanded
    assert len(expanded) <= MOST_EXPANSION * len(packed) + 1
    with pytest.raises(ValueError, match="other than"):
        expand_lzf(packed, len(expanded) + 1)


@given(st.binary(max_size=60), st.integers(0, 400))
def test_any_bytes_expand_to_their_size_or_are_refused(packed: bytes, size: int) -> None:
    with suppress(ValueError):
        assert len(expand_lzf(packed, size)) == size
