"""A shell over SSH, against a real server: commands, files that resume, ports, and vanishing."""

from __future__ import annotations

import hashlib
import os
import socket
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import paramiko
import pytest
from machines.servers import USER, Machines, Server

from hpccomponent.errors import CloudError
from hpcdeploy.login.shell import part_of
from hpcdeploy.login.ssh import shell as ssh_shell
from hpcdeploy.login.ssh.connect import connect
from hpcdeploy.login.ssh.shell import SshShell
from hpcdeploy.login.ssh.target import SshTarget

CONTENT = bytes(range(256)) * 1000


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    with Machines.open(tmp_path) as machines:
        yield machines


@pytest.fixture
def server(machines: Machines) -> Server:
    return machines.add()


@pytest.fixture(scope="module")
def key(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("key") / "id"
    paramiko.RSAKey.generate(2048).write_private_key_file(str(path))
    return path


@pytest.fixture
def shell(server: Server, key: Path) -> Iterator[SshShell]:
    loaded = paramiko.RSAKey.from_private_key_file(str(key))
    server.keys.append(f"ssh-rsa {loaded.get_base64()}")
    target = SshTarget(server.address, server.port, USER, (str(key),), (server.known,))
    with ExitStack() as closer:
        connection = connect(target, closer)
        with SshShell("worker-1", connection, closer.pop_all()) as shell:
            yield shell


def test_stdin_reaches_the_command_and_no_command_line(shell: SshShell, server: Server) -> None:
    assert shell.run("cat", stdin=b"a secret").output == "a secret"
    assert not any("a secret" in command for command in server.commands)


def test_commands_run_in_the_home(shell: SshShell, server: Server) -> None:
    assert shell.run("pwd").output.strip() == str(server.home)


def test_an_answer_without_an_end_is_named(
    shell: SshShell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ssh_shell, "MOST_OUTPUT", 1 << 20)
    with pytest.raises(CloudError, match="worker-1: a command says more than 1 MiB"):
        shell.run("exec cat /dev/zero")
    done = shell.run("head -c 3000000 /dev/zero >&2")
    assert done.exit_code == 0
    assert 0 < len(done.errors) <= 1 << 20


def test_a_line_without_an_end_comes_in_pieces(
    shell: SshShell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ssh_shell, "LONGEST_LINE", 1000)
    lines: list[str] = []
    assert shell.follow("head -c 2500 /dev/zero; echo; echo short", lines.append) == 0
    assert [len(line) for line in lines] == [1000, 1000, 500, 5]


def test_of_a_greeting_without_an_end_the_last_lines_are_kept(
    shell: SshShell, server: Server
) -> None:
    no_shell = server.home / "bin/sh"
    no_shell.parent.mkdir()
    no_shell.write_text("#!/bin/sh\nseq 1000; echo why >&2; exit 3\n")
    no_shell.chmod(0o755)
    server.path = f"{server.home}/bin:{server.path}"
    lines: list[str] = []
    assert shell.follow("true", lines.append) == 3
    kept = [str(number) for number in range(1001 - ssh_shell.MOST_GREETING, 1001)]
    assert lines == [*kept, "why"]


def test_a_command_that_takes_too_long_is_named(shell: SshShell) -> None:
    with pytest.raises(CloudError, match=r"worker-1: 'cat .*' did not end within 0 s"):
        shell.run("cat /dev/tty 2>/dev/null; tail -f /dev/null", timeout_s=0.2)


def test_a_vanished_connection_is_told_as_such(
    shell: SshShell, server: Server, machines: Machines
) -> None:
    seen = threading.Event()

    def cut() -> None:
        seen.wait()
        machines.stop(server)

    cutter = threading.Thread(target=cut, daemon=True)
    cutter.start()
    with pytest.raises(CloudError, match="worker-1: the connection was lost"):
        shell.follow("echo up; tail -f /dev/null", lambda line: seen.set())
    cutter.join()
    with pytest.raises(CloudError, match="worker-1"):
        shell.run("true")


def test_lines_are_handed_over_as_they_come(shell: SshShell) -> None:
    lines: list[str] = []
    code = shell.follow("echo one; echo two >&2; echo three; exit 4", lines.append)
    assert (sorted(lines), code) == (["one", "three", "two"], 4)


def test_a_file_arrives_whole_and_with_its_mode(
    shell: SshShell, server: Server, tmp_path: Path
) -> None:
    source = tmp_path / "source"
    source.write_bytes(CONTENT)
    steps: list[tuple[int, int]] = []
    shell.put(source, "a b/target", mode=0o640, on_progress=lambda *step: steps.append(step))
    target = server.home / "a b/target"
    assert target.read_bytes() == CONTENT
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert steps[-1] == (len(CONTENT), len(CONTENT))
    assert list(target.parent.iterdir()) == [target]


@pytest.mark.parametrize("held", [CONTENT[:100_000], b"of another file", b"", CONTENT + b"more"])
def test_sending_goes_on_where_it_was_cut_short(
    shell: SshShell, server: Server, tmp_path: Path, held: bytes
) -> None:
    source = tmp_path / "source"
    source.write_bytes(CONTENT)
    (server.home / "target.part").write_bytes(held)
    first: list[int] = []
    shell.put(source, "target", on_progress=lambda done, _: first.append(done))
    assert (server.home / "target").read_bytes() == CONTENT
    assert (first[0] > 100_000) == (held == CONTENT[:100_000])


def test_what_is_there_already_is_not_sent_again(
    shell: SshShell, server: Server, tmp_path: Path
) -> None:
    source = tmp_path / "source"
    source.write_bytes(CONTENT)
    (server.home / "target").write_bytes(CONTENT)
    steps: list[int] = []
    shell.put(source, "target", on_progress=lambda done, _: steps.append(done))
    assert steps == []


@pytest.mark.parametrize("held", [CONTENT[:100_000], b"of another file", None])
def test_fetching_goes_on_where_it_was_cut_short(
    shell: SshShell, server: Server, tmp_path: Path, held: bytes | None
) -> None:
    (server.home / "source").write_bytes(CONTENT)
    if held is not None:
        part_of(tmp_path / "target").write_bytes(held)
    (tmp_path / "target.part").write_bytes(b"the user's")
    shell.get("source", tmp_path / "target")
    fetched = (tmp_path / "target").read_bytes()
    assert hashlib.sha256(fetched).digest() == hashlib.sha256(CONTENT).digest()
    assert not part_of(tmp_path / "target").exists()
    assert (tmp_path / "target.part").read_bytes() == b"the user's"


@pytest.fixture
def replace_tool(server: Server) -> Callable[[str, str], None]:
    """What lets a program of the machine say something else."""

    def replace_tool(name: str, said: str) -> None:
        tool = server.home / "bin" / name
        tool.parent.mkdir()
        tool.write_text(f"#!/bin/sh\necho '{said}'\n")
        tool.chmod(0o755)
        server.path = f"{tool.parent}:{server.path}"

    return replace_tool


@pytest.mark.parametrize("size", [2**62, len(CONTENT) + 1])
def test_a_size_that_is_far_too_large_costs_nothing(
    shell: SshShell,
    server: Server,
    tmp_path: Path,
    size: int,
    replace_tool: Callable[[str, str], None],
) -> None:
    (server.home / "source").write_bytes(CONTENT)
    replace_tool("wc", str(size))
    shell.get("source", tmp_path / "target")
    assert (tmp_path / "target").read_bytes() == CONTENT


@pytest.mark.parametrize("size", [len(CONTENT) - 1, 0])
def test_no_more_comes_than_was_said(
    shell: SshShell,
    server: Server,
    tmp_path: Path,
    size: int,
    replace_tool: Callable[[str, str], None],
) -> None:
    (server.home / "source").write_bytes(CONTENT)
    replace_tool("wc", str(size))
    with pytest.raises(CloudError, match="source: arrived damaged, twice"):
        shell.get("source", tmp_path / "target")
    assert not (tmp_path / "target").exists()
    assert part_of(tmp_path / "target").stat().st_size == size


def test_nothing_is_written_through_a_link(shell: SshShell, server: Server, tmp_path: Path) -> None:
    (server.home / "source").write_bytes(CONTENT)
    (tmp_path / "precious").write_bytes(b"stays")
    part_of(tmp_path / "target").symlink_to(tmp_path / "precious")
    with pytest.raises(CloudError, match="target: Too many levels of symbolic links"):
        shell.get("source", tmp_path / "target")
    assert (tmp_path / "precious").read_bytes() == b"stays"


@pytest.mark.parametrize("said", ["", "no checksum", "../../x  source", "0" * 63])
def test_a_checksum_that_is_none_is_one_line(
    shell: SshShell,
    server: Server,
    tmp_path: Path,
    said: str,
    replace_tool: Callable[[str, str], None],
) -> None:
    replace_tool("sha256sum", said)
    (server.home / "source").write_bytes(CONTENT)
    with pytest.raises(CloudError, match="source: its checksum cannot be had"):
        shell.get("source", tmp_path / "target")


def test_a_file_that_is_not_there_is_named(shell: SshShell, tmp_path: Path) -> None:
    with pytest.raises(CloudError, match=r"worker-1: nowhere -> .*No such file"):
        shell.get("nowhere", tmp_path / "target")


def test_a_forwarded_port_leads_through(shell: SshShell) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = shell.forward("127.0.0.1", listener.getsockname()[1])
        with socket.create_connection(("127.0.0.1", port)) as near:
            far, _ = listener.accept()
            with far:
                near.sendall(b"ping")
                assert far.recv(10) == b"ping"
                far.sendall(b"pong")
                assert near.recv(10) == b"pong"
                far.shutdown(socket.SHUT_RDWR)
            assert near.recv(10) == b""


def test_bytes_go_through_a_command_without_a_terminal(
    shell: SshShell, tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    (tmp_path / "in").write_bytes(b"typed\n")
    before = os.dup(0)
    with (tmp_path / "in").open("rb") as stream:
        os.dup2(stream.fileno(), 0)
        try:
            assert shell.interact("cat; exit 5") == 5
        finally:
            os.dup2(before, 0)
            os.close(before)
    assert capfdbinary.readouterr().out == b"typed\n"
