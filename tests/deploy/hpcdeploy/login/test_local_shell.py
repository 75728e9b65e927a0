"""A node that is a folder: its commands, its files, and the lease that a guard reads."""

from __future__ import annotations

import stat
from datetime import UTC, datetime
from pathlib import Path

import pytest

from hpccomponent.errors import CloudError
from hpcdeploy.install import user_data
from hpcdeploy.login.local_shell import LocalShell


@pytest.fixture
def shell(tmp_path: Path) -> LocalShell:
    (tmp_path / "home").mkdir()
    return LocalShell("worker-1", tmp_path / "home")


def test_the_folder_is_the_home(shell: LocalShell, tmp_path: Path) -> None:
    done = shell.run("pwd; echo $HOME; cat >&2; exit 3", stdin=b"in")
    home = str(tmp_path / "home")
    assert (done.exit_code, done.output.split(), done.errors) == (3, [home, home], "in")


def test_a_signal_is_told_as_a_shell_does(shell: LocalShell) -> None:
    assert shell.run("kill -TERM $$").exit_code == 128 + 15


def test_what_takes_too_long_is_ended_with_all_it_started(shell: LocalShell) -> None:
    with pytest.raises(CloudError, match=r"worker-1: 'tail .*' did not end within 0 s"):
        shell.run("tail -f /dev/null | cat", timeout_s=0.2)


def test_lines_are_handed_over(shell: LocalShell) -> None:
    lines: list[str] = []
    assert shell.follow("echo one; echo two >&2; exit 4", lines.append) == 4
    assert lines == ["one", "two"]


def test_files_are_copied_with_their_mode(shell: LocalShell, tmp_path: Path) -> None:
    (tmp_path / "source").write_text("text")
    shell.put(tmp_path / "source", "a/target", mode=0o640)
    assert stat.S_IMODE((tmp_path / "home/a/target").stat().st_mode) == 0o640
    shell.get("a/target", tmp_path / "back")
    assert (tmp_path / "back").read_text() == "text"
    (tmp_path / "new").touch()
    assert (tmp_path / "back").stat().st_mode == (tmp_path / "new").stat().st_mode


def test_a_file_that_is_not_there_is_named(shell: LocalShell, tmp_path: Path) -> None:
    with pytest.raises(CloudError, match=r"worker-1: .*nowhere: No such file"):
        shell.get("nowhere", tmp_path / "back")


def test_a_folder_that_is_gone_is_named(tmp_path: Path) -> None:
    with pytest.raises(CloudError, match="gone: No such file"):
        LocalShell("worker-1", tmp_path / "gone").run("true")


def test_a_lease_is_extended_where_a_guard_reads_it(
    shell: LocalShell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = tmp_path / "limits"
    monkeypatch.setattr(user_data, "_LIMITS", str(limits))
    until = datetime.fromtimestamp(2_000_000_000, UTC)
    user_data.extend_lease(shell, until)
    assert not limits.exists()
    limits.write_text("lease_until 1\nidle_s 900\n")
    for _ in range(2):
        user_data.extend_lease(shell, until)
        assert limits.read_text() == "lease_until 2000000000\nidle_s 900\n"
