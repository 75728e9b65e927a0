from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.files.checksum import checksum, note_written, take_written
from hpccomponent.files.whole_files import write_whole
from hpccomponent.store.base import FolderStore


@given(content=st.binary(min_size=1, max_size=9000), flipped=st.integers(0, 8 * 9000 - 1))
def test_a_flipped_bit_changes_it(content: bytes, flipped: int) -> None:
    flipped %= 8 * len(content)
    changed = bytearray(content)
    changed[flipped // 8] ^= 1 << flipped % 8
    assert checksum([content]) != checksum([changed])


def test_what_was_written_is_told_once(tmp_path: Path) -> None:
    take_written()
    write_whole(tmp_path / "a", [b"one", b"two"])
    first = take_written()
    assert first
    assert take_written() == 0
    note_written(b"one", b"two")
    assert take_written() == first


@pytest.mark.parametrize("is_there", [False, True])
def test_a_value_counts_as_written_where_it_was_there_before(
    tmp_path: Path, is_there: bool
) -> None:
    store, value = FolderStore(tmp_path), np.arange(5000.0)
    store.put("name", value)
    expected = take_written()
    if not is_there:
        store.delete("name")
    store.put("name", value, replaces=False)
    assert take_written() == expected
    store.put("name", value + 1.0, replaces=False)
    assert take_written() != expected
    assert np.array_equal(store.get("name"), value)  # what is being read stays
