"""The shell against a real OpenSSH server on loopback, as whoever runs the tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from machines.openssh import open_sshd

from hpccomponent.errors import CloudError
from hpcdeploy.login.ssh.connect import connect
from hpcdeploy.login.ssh.reach import LoginFault, ReachError
from hpcdeploy.login.ssh.shell import SshShell
from hpcdeploy.login.ssh.target import SshTarget


@pytest.fixture
def target(tmp_path: Path) -> Iterator[SshTarget]:
    with open_sshd(tmp_path) as target:
        yield target


@pytest.fixture
def shell(target: SshTarget) -> Iterator[SshShell]:
    with ExitStack() as closer:
        connection = connect(target, closer)
        with SshShell("worker-1", connection, closer.pop_all()) as shell:
            yield shell


def greet(folder: Path, line: str) -> None:
    """Let the server's login shell run a line first, as one of ``~/.bashrc``."""
    enter = folder / "enter"
    enter.write_text(enter.read_text().replace("\n", f"\n{line}\n", 1))


def test_a_command_runs_with_its_streams_and_its_code(shell: SshShell) -> None:
    done = shell.run("cat; echo err >&2; exit 3", stdin=b"in")
    assert (done.exit_code, done.output, done.errors) == (3, "in", "err\n")


def test_much_output_on_both_streams_blocks_nothing(shell: SshShell) -> None:
    done = shell.run("head -c 5000000 /dev/zero; head -c 5000000 /dev/zero >&2")
    assert (len(done.output), len(done.errors)) == (5_000_000, 5_000_000)


@pytest.mark.parametrize(("command", "code"), [("sh -c 'kill -9 $$'", 137), ("kill -9 $$", 128)])
def test_a_signal_is_an_exit_code(shell: SshShell, command: str, code: int) -> None:
    assert shell.run(command).exit_code == code


def test_a_file_goes_there_and_back(shell: SshShell, tmp_path: Path) -> None:
    content = bytes(range(256)) * 4000
    (tmp_path / "source").write_bytes(content)
    (tmp_path / "there.part").write_bytes(content[:1000])
    shell.put(tmp_path / "source", str(tmp_path / "there"))
    shell.get(str(tmp_path / "there"), tmp_path / "back")
    assert (tmp_path / "back").read_bytes() == content


def test_names_on_the_machine_are_bytes(shell: SshShell, tmp_path: Path) -> None:
    odd = os.fsdecode(b"\xff\xfe.ply")
    content = bytes(range(256)) * 4000
    (tmp_path / odd).write_bytes(content)
    shell.put(tmp_path / odd, f"{tmp_path}/a/{odd}")
    shell.get(f"{tmp_path}/a/{odd}", tmp_path / f"back {odd}")
    assert (tmp_path / f"back {odd}").read_bytes() == content
    assert shell.run(f"test -f '{tmp_path}/a/{odd}'").exit_code == 0
    with pytest.raises(CloudError, match="No such file"):
        shell.get(f"b/{odd}", tmp_path / odd)


def test_a_detached_process_holds_nothing_up(shell: SshShell, tmp_path: Path) -> None:
    done = shell.run(f"sleep 600 </dev/null >/dev/null 2>&1 & echo $! >{tmp_path}/pid")
    assert done.exit_code == 0
    assert shell.run(f"kill $(cat {tmp_path}/pid)").exit_code == 0


@pytest.mark.parametrize("end", ["\n", ""], ids=["line", "no-line"])
def test_what_start_up_files_print_is_no_part_of_what_a_command_says(
    shell: SshShell, tmp_path: Path, end: str
) -> None:
    greet(tmp_path, f"printf 'Welcome%s' '{end}'; printf 'a warning%s' '{end}' >&2")
    done = shell.run("cat; echo err >&2; exit 3", stdin=b"in")
    assert (done.exit_code, done.output, done.errors) == (3, "in", "err\n")
    lines: list[str] = []
    assert shell.follow("echo one; echo two >&2", lines.append) == 0
    assert sorted(lines) == ["one", "two"]


def test_where_no_shell_runs_a_command_what_is_printed_instead_is_told(
    shell: SshShell, tmp_path: Path
) -> None:
    greet(tmp_path, "echo This account is not available.; exit 1")
    assert shell.run("true").output == "This account is not available.\n"
    lines: list[str] = []
    assert shell.follow("true", lines.append) == 1
    assert lines == ["This account is not available."]


def test_a_login_shell_that_talks_damages_no_file(shell: SshShell, tmp_path: Path) -> None:
    greet(tmp_path, "echo Welcome to this machine, and behave yourself.; echo warning >&2")
    (tmp_path / "source").write_bytes(bytes(range(256)))
    shell.put(tmp_path / "source", str(tmp_path / "there"))
    shell.get(str(tmp_path / "there"), tmp_path / "back")
    assert (tmp_path / "back").read_bytes() == bytes(range(256))


def test_why_a_file_cannot_be_written_is_told(shell: SshShell, tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.write_bytes(bytes(50_000_000))
    with pytest.raises(CloudError, match=r"source -> /dev/full/x: .*(Not a directory|File exists)"):
        shell.put(source, "/dev/full/x")
    with pytest.raises(CloudError, match=f"source -> {tmp_path}: it is a folder"):
        shell.put(source, str(tmp_path))
    greet(tmp_path, "trap '' XFSZ; ulimit -f 100")  # no more room than this
    with pytest.raises(CloudError, match=r"there: .*File too large"):
        shell.put(source, str(tmp_path / "there"))


def test_a_host_key_that_nobody_knows_is_refused(target: SshTarget) -> None:
    unknown = SshTarget(target.address, target.port, target.user, target.key_files)
    with ExitStack() as closer, pytest.raises(ReachError) as caught:
        connect(unknown, closer)
    assert caught.value.reach is LoginFault.HOST_KEY_UNKNOWN
