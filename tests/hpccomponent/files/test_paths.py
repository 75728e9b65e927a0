"""Paths as people write them: a home in front, and what is no file."""

from __future__ import annotations

import os
import pwd
import socket
from pathlib import Path

import pytest

from hpccomponent.errors import ConfigError, UsageError
from hpccomponent.files.paths import check_regular, expand_home, home_folder, read_regular
from hpccomponent.protocol.keys import read_private_json

ME = pwd.getpwuid(os.getuid())


def test_a_home_in_front_is_written_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/homes/me")
    assert expand_home("~") == Path("/homes/me")
    assert expand_home("~/a/b") == Path("/homes/me/a/b")
    assert expand_home(Path("~/a")) == Path("/homes/me/a")
    assert expand_home(f"~{ME.pw_name}/a") == Path(ME.pw_dir) / "a"
    for same in ("a/~b", "./~x", "/a/~", ""):
        assert expand_home(same) == Path(same)


@pytest.mark.parametrize("home", [None, ""])
def test_a_home_that_is_not_named_is_the_systems(
    home: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HOME")
    if home is not None:
        monkeypatch.setenv("HOME", home)
    assert home_folder() == Path(ME.pw_dir)
    assert expand_home("~/a") == Path(ME.pw_dir) / "a"


def test_no_home_at_all_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "not/absolute")
    with pytest.raises(UsageError, match="set HOME to it"):
        home_folder()
    with pytest.raises(UsageError, match="knows no user 'nobody-of-that-name'; write"):
        expand_home("~nobody-of-that-name/x")


def test_what_is_no_file_is_named_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe", 0o600)
    with socket.socket(socket.AF_UNIX) as end:
        end.bind(str(tmp_path / "socket"))
    for name, words in (
        ("pipe", "it is a pipe"),
        ("socket", "it is a socket"),
        ("/dev/zero", "it is a device"),
        (".", "Is a directory"),
    ):
        path = tmp_path / name
        with pytest.raises(UsageError, match=words):
            check_regular(path)
        with pytest.raises(OSError, match="No such device" if name == "socket" else words):
            read_regular(path)
        with pytest.raises(ConfigError, match="cannot be read"):
            read_private_json(path, 1, ("version",))
    (tmp_path / "file").write_bytes(b"content")
    check_regular(tmp_path / "file")
    check_regular(tmp_path / "none")
    assert read_regular(tmp_path / "file") == b"content"
    assert read_regular(tmp_path / "file", 3) == b"con"
