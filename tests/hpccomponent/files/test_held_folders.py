"""Whose a folder is, is told by a lock that ends with its process; nothing else is removed."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hpccomponent.errors import OutputError
from hpccomponent.files.held_folders import (
    create_held,
    hold,
    read_owner,
    remove_abandoned,
    temporary_folder,
)
from hpccomponent.files.private_files import create_private, make_private_folder

HOLDER = """
import os, sys
from pathlib import Path
from hpccomponent.files.held_folders import create_held
os.umask(int(sys.argv[2], 8))
held = create_held(Path(sys.argv[1]))
(held.path / "inner").mkdir()
(held.path / "inner" / "file").write_text("points")
print("held", flush=True)
sys.stdin.read()
"""

Holder = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start_holder() -> Iterator[Holder]:
    """Give a function that starts a process which makes and holds a folder."""
    started: list[subprocess.Popen[str]] = []

    def start(path: Path, umask: str = "022") -> subprocess.Popen[str]:
        command = [sys.executable, "-P", "-c", HOLDER, str(path), umask]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_only_what_a_killed_process_held_is_removed(tmp_path: Path, start_holder: Holder) -> None:
    killed, living = start_holder(tmp_path / "x-1"), start_holder(tmp_path / "x-2")
    start_holder(tmp_path / "y-1").kill()
    killed.kill()
    killed.wait()
    owners = remove_abandoned(tmp_path, "x-")
    assert [owner.pid for owner in owners] == [living.pid]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x-2", "y-1"]
    assert (tmp_path / "x-2" / "inner" / "file").read_text() == "points"


def test_a_name_or_an_age_makes_no_folder_ours_to_remove(tmp_path: Path) -> None:
    """What has no lock, or a lock of something else, stays."""
    keep = tmp_path / "keep"
    keep.mkdir()
    (keep / "file").write_text("keep")
    (tmp_path / "x-bare").mkdir()
    os.utime(tmp_path / "x-bare", (0, 0))
    (tmp_path / "x-link").symlink_to(keep)
    (tmp_path / "x-file").write_text("a file")
    owned = json.dumps({"user": "u", "host": "h", "pid": 1, "command": "c"})
    (keep / ".owner").write_text(owned)
    for name in ("x-lock-link", "x-lock-pipe", "x-lock-empty", "x-lock-junk", "x-other-host"):
        (tmp_path / name).mkdir()
    (tmp_path / "x-lock-link" / ".owner").symlink_to(keep / ".owner")
    os.mkfifo(tmp_path / "x-lock-pipe" / ".owner")
    (tmp_path / "x-lock-empty" / ".owner").write_text("")
    (tmp_path / "x-lock-junk" / ".owner").write_text("[1, 2")
    (tmp_path / "x-other-host" / ".owner").write_text(owned)
    before = set(tmp_path.rglob("*"))
    assert [owner.host for owner in remove_abandoned(tmp_path, "x-")] == ["h"]
    assert set(tmp_path.rglob("*")) == before
    assert remove_abandoned(tmp_path / "none", "x-") == []


def test_a_link_in_a_folder_that_goes_leads_nowhere(tmp_path: Path, start_holder: Holder) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "file").write_text("keep")
    killed = start_holder(tmp_path / "x-1")
    (tmp_path / "x-1" / "inner" / "link").symlink_to(outside)
    (tmp_path / "x-1" / "link").symlink_to(outside)
    killed.kill()
    killed.wait()
    assert remove_abandoned(tmp_path, "x-") == []
    assert [path.name for path in tmp_path.iterdir()] == ["outside"]
    assert (outside / "file").read_text() == "keep"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes folders of others")
def test_what_belongs_to_another_user_stays(tmp_path: Path, start_holder: Holder) -> None:
    killed = start_holder(tmp_path / "x-1")
    killed.kill()
    killed.wait()
    os.chown(tmp_path / "x-1", 12345, 12345)
    assert remove_abandoned(tmp_path, "x-") == []
    assert hold(tmp_path / "x-1") is None
    assert (tmp_path / "x-1" / "inner" / "file").exists()
    os.chown(tmp_path / "x-1", 0, 0)
    os.chown(tmp_path / "x-1" / ".owner", 12345, 12345)
    assert remove_abandoned(tmp_path, "x-") == []
    assert (tmp_path / "x-1" / "inner" / "file").exists()


@pytest.mark.parametrize("umask", ["000", "077", "777"])
def test_a_folder_is_private_whatever_the_umask(
    umask: str, tmp_path: Path, start_holder: Holder
) -> None:
    start_holder(tmp_path / "x-1", umask if umask != "777" else "077")
    assert (tmp_path / "x-1").stat().st_mode & 0o777 == 0o700
    assert (tmp_path / "x-1" / ".owner").stat().st_mode & 0o777 == 0o600
    before = os.umask(int(umask, 8))
    try:
        make_private_folder(tmp_path / "a" / "b")
        create_private(tmp_path / "a" / "file").close()
    finally:
        os.umask(before)
    assert [(tmp_path / name).stat().st_mode & 0o777 for name in ("a", "a/b", "a/file")] == [
        0o700, 0o700, 0o600,
    ]  # fmt: skip


def test_who_holds_a_folder_can_be_named_and_waited_for(
    tmp_path: Path, start_holder: Holder
) -> None:
    holder = start_holder(tmp_path / "x-1")
    owner = read_owner(tmp_path / "x-1")
    assert owner is not None
    assert owner.pid == holder.pid
    assert hold(tmp_path / "x-1") is None
    holder.kill()
    held = hold(tmp_path / "x-1", waits=True)
    assert held is not None
    again = read_owner(tmp_path / "x-1")
    assert again is not None
    assert again.pid == os.getpid()
    held.remove()
    assert hold(tmp_path / "x-1", waits=True) is None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_file_system_without_locks_keeps_everything(
    code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def flock(*_: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", flock)
    first = create_held(tmp_path / "x-1")
    second = create_held(tmp_path / "x-2")
    assert remove_abandoned(tmp_path, "x-") == []
    again = hold(tmp_path / "x-1")  # for a job that resumes: its user says that it is dead
    assert again is not None
    again.let_go()
    for held in (first, second):
        held.remove()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be made: Not a directory"):
        create_held(tmp_path / "file" / "x")
    with monkeypatch.context() as patch:
        patch.setattr("tempfile.tempdir", str(tmp_path / "file"))
        with pytest.raises(OutputError, match="cannot be made"), temporary_folder():
            pass
