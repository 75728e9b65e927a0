"""Values come back as they were stored, from a folder and from a bucket, or not at all."""

from __future__ import annotations

import errno
import gc
import os
import shutil
import socket
import sys
import threading
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.errors import CloudError, JobError, OutputError, UsageError
from hpccomponent.store.base import FolderStore, Store
from hpccomponent.store.places import hold_store, open_store
from hpccomponent.store.value import DamagedError, from_bytes, to_buffers

if TYPE_CHECKING:
    from lab_bucket import Bucket

pytest_plugins = ["lab_bucket"]
pytestmark = pytest.mark.usefixtures("endpoint")

VALUES: list[object] = [
    np.arange(100_000.0).reshape(-1, 4),
    np.zeros((0, 3), np.float32),
    {"keys": np.arange(20_000), "small": np.arange(3, dtype=np.uint8), "name": "tile"},
    (1, 2.5, None, True, b"bytes" * 5_000, "text", [1, (2, 3)]),
]


@pytest.fixture(params=["folder", "bucket"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    if request.param == "folder":
        return open_store(str(tmp_path / "new/store"))
    request.getfixturevalue("bucket")
    return open_store("s3://lab/jobs/7/")


def _assert_same(one: object, other: object) -> None:
    assert type(one) is type(other)
    if isinstance(one, np.ndarray):
        assert isinstance(other, np.ndarray)
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, dict):
        assert isinstance(other, dict)
        assert list(one) == list(other)
        for key in one:
            _assert_same(one[key], other[key])
    elif isinstance(one, tuple | list):
        assert isinstance(other, tuple | list)
        assert len(one) == len(other)
        for mine, its in zip(one, other, strict=True):
            _assert_same(mine, its)
    else:
        assert one == other


def test_a_bucket_takes_boto3(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "hpccomponent.store.s3", raising=False)
    monkeypatch.setitem(sys.modules, "boto3", None)
    with pytest.raises(CloudError, match="boto3 is not installed on this machine"):
        open_store("s3://lab")


def test_values_come_back(store: Store) -> None:
    for i, value in enumerate(VALUES):
        store.put(f"tile/{i}", value)
    for i, value in enumerate(VALUES):
        _assert_same(store.get(f"tile/{i}"), value)


def test_names_are_listed_looked_up_and_taken_away(store: Store) -> None:
    for name in ("b/2", "a", "b/1", "b.x/1"):
        store.put(name, name)
    assert store.list() == ["a", "b.x/1", "b/1", "b/2"]
    assert store.list("b/") == ["b/1", "b/2"]
    assert store.list("c") == []
    assert store.has("a")
    store.delete("a")
    store.delete("a")
    assert not store.has("a")
    with pytest.raises(JobError, match="/a is not there"):
        store.get("a")


def test_the_last_value_of_a_name_counts(store: Store) -> None:
    store.put("a", np.arange(10_000))
    before = store.get("a")
    store.put("a", np.ones(10_000))
    assert store.get("a").sum() == 10_000
    assert before.tolist() == list(range(10_000))  # whoever holds the old one keeps it


@pytest.mark.parametrize("name", ["", "/a", "a/", "../a", "a/../b", ".a", "a//b", "a b", "ä"])
def test_names_that_could_lead_elsewhere_are_refused(store: Store, name: str) -> None:
    calls = (store.get, store.has, store.delete, lambda name: store.put(name, 1))
    for call in calls:
        with pytest.raises(UsageError, match="cannot be the name of a value"):
            call(name)


def test_what_may_not_travel_is_not_stored(store: Store) -> None:
    with pytest.raises(UsageError):
        store.put("a", object())
    assert not store.has("a")


def test_many_write_one_name_and_one_of_them_wins(store: Store) -> None:
    values = [np.full(50_000, i) for i in range(4)]
    threads = [threading.Thread(target=store.put, args=("a", value)) for value in values]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    found = store.get("a")
    assert any((found == value).all() for value in values)
    assert store.list() == ["a"]


def _content(value: object) -> bytes:
    return b"".join(to_buffers(value))


@given(st.integers(0, 10**9), st.integers(1, 255))
def test_any_changed_byte_is_found_out(at: int, change: int) -> None:
    content = bytearray(_content((np.arange(2_000), "text")))
    content[at % len(content)] ^= change
    with pytest.raises(DamagedError):
        from_bytes(memoryview(bytes(content)))


@given(st.integers(0, 40), st.integers(1, 100_000))
def test_a_cut_or_longer_value_is_found_out(pages: int, change: int) -> None:
    content = _content((np.zeros(pages * 512), np.zeros(3)))
    for other in (content[:-change], content + bytes(change)):
        with pytest.raises(DamagedError):
            from_bytes(memoryview(other))


def test_pages_that_change_places_are_found_out() -> None:
    content = _content(np.arange(4_096))
    start = content.index(np.arange(16).tobytes())
    first, second = content[start : start + 4096], content[start + 4096 : start + 8192]
    with pytest.raises(DamagedError, match="checksum"):
        from_bytes(memoryview(content[:start] + second + first + content[start + 8192 :]))


@given(st.binary(max_size=200), st.integers(0, 200))
def test_other_bytes_are_no_value(junk: bytes, kept: int) -> None:
    for content in (junk, b"hpcvalue3" + junk, _content(7)[: min(kept, len(_content(7)) - 1)]):
        with pytest.raises(DamagedError):
            from_bytes(memoryview(content))


def test_a_damaged_value_is_named(bucket: Bucket, tmp_path: Path) -> None:
    content = _content(np.arange(10_000))[:-1]
    bucket.put_object(Key="a", Body=content)
    (tmp_path / "a").write_bytes(content)
    (tmp_path / "empty").write_bytes(b"")
    for place, name in (("s3://lab", "a"), (str(tmp_path), "a"), (f"folder:{tmp_path}", "empty")):
        with pytest.raises(JobError, match=f"/{name} .*(length|empty)") as refusal:
            open_store(place).get(name)
        assert refusal.value.exit_code == 1


def test_a_file_is_checked_when_it_is_first_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked: list[int] = []

    def check(content: bytes, before: int) -> int:
        checked.append(len(content))
        return crc32(content, before)

    crc32 = zlib.crc32
    store = FolderStore(tmp_path)
    for value in (1, 2):  # another file of the same name is checked anew
        store.put("a", np.full(10_000, value))
        for is_first in (True, False, False):
            checked.clear()
            with monkeypatch.context() as patch:
                patch.setattr(zlib, "crc32", check)
                found = store.get("a")
            assert found.tolist() == [value] * 10_000
            assert bool(checked) == is_first


def test_arrays_of_a_folder_are_mapped_and_let_go(tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    store.put("a", np.arange(1_000_000))
    found = store.get("a")
    assert not found.flags.writeable
    assert found.ctypes.data % 64 == 0
    assert str(tmp_path / "a") in Path("/proc/self/maps").read_text()
    del found
    gc.collect()
    assert str(tmp_path / "a") not in Path("/proc/self/maps").read_text()


def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = FolderStore(tmp_path)
    store.put("a", 1)

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OutputError, match=r"/a: cannot be written: No space left on device; check"):
        store.put("a", np.arange(100_000))
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert store.get("a") == 1


def test_a_late_task_brings_nothing_back(tmp_path: Path) -> None:
    (tmp_path / "job").mkdir()
    held = hold_store(str(tmp_path))
    held.put("job/tile", 1)
    assert held.get("job/tile") == 1
    shutil.rmtree(tmp_path / "job")
    with pytest.raises(OutputError, match="job/tile: cannot be written: No such file"):
        held.put("job/tile", 1)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file/store: cannot be written"):
        open_store(f"folder:{tmp_path}/file/store")


@pytest.mark.parametrize("place", ["", "http://host/x", "gs://bucket"])
def test_places_of_other_kinds_are_refused(place: str) -> None:
    with pytest.raises(UsageError, match="no store is known"):
        open_store(place)


def test_tasks_share_a_client(bucket: Bucket, tmp_path: Path) -> None:
    assert hold_store("s3://lab/a") is hold_store("s3://lab/a")
    assert hold_store("s3://lab/a") is not hold_store("s3://lab/b")
    hold_store("s3://lab/a").put("x", 1)
    assert open_store("s3://lab/a").get("x") == 1
    for _ in range(2):  # what could not be opened is tried again
        with pytest.raises(CloudError, match="there is no bucket 'other'"):
            hold_store("s3://other/prefix")


def test_a_bucket_must_have_a_name_and_be_there(bucket: Bucket) -> None:
    with pytest.raises(UsageError, match="names no bucket"):
        open_store("s3://")
    with pytest.raises(CloudError, match="there is no bucket 'other'; create it") as refusal:
        open_store("s3://other/prefix")
    assert refusal.value.exit_code == 4
    with pytest.raises(CloudError, match="s3://No_Bucket!"):
        open_store("s3://No_Bucket!")


def test_missing_credentials_are_one_clear_line(bucket: Bucket, keys: pytest.MonkeyPatch) -> None:
    keys.delenv("AWS_ACCESS_KEY_ID")
    keys.delenv("AWS_SECRET_ACCESS_KEY")
    with pytest.raises(CloudError, match=r"s3://lab: there are no credentials; set AWS_ACCESS_KEY"):
        open_store("s3://lab")
    keys.setenv("AWS_PROFILE", "unknown")
    with pytest.raises(CloudError, match="profile"):
        open_store("s3://lab")


def test_an_endpoint_that_does_not_answer(keys: pytest.MonkeyPatch) -> None:
    with socket.socket() as held:  # bound, and nobody listens
        held.bind(("127.0.0.1", 0))
        keys.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{held.getsockname()[1]}")
        keys.setattr("time.sleep", lambda _seconds: None)  # between boto3's attempts
        with pytest.raises(CloudError, match="check AWS_ENDPOINT_URL"):
            open_store("s3://lab")


def test_a_bucket_that_goes_away_is_named(bucket: Bucket) -> None:
    store = open_store("s3://lab")
    bucket.delete()
    with pytest.raises(CloudError, match=r"s3://lab: PutObject was refused \(NoSuchBucket\)"):
        store.put("a", 1)
    with pytest.raises(CloudError, match="NoSuchBucket"):
        store.get("a")
    bucket.create()
