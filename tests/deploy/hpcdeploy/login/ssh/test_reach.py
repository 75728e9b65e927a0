"""Why a machine cannot be logged in to: real sockets that play every kind of bad server."""

from __future__ import annotations

import getpass
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from copy import copy
from dataclasses import replace
from pathlib import Path

import pytest
from machines.openssh import open_sshd, start_sshd
from machines.rude import ACTS, open_rude
from machines.servers import USER, Machines, Server

from hpcdeploy.login.ssh.connect import connect
from hpcdeploy.login.ssh.connection import SshConnection, SshTimeouts
from hpcdeploy.login.ssh.keys import find_identities, public_key, read_key
from hpcdeploy.login.ssh.reach import LoginFault, ReachError
from hpcdeploy.login.ssh.shell import SshShell
from hpcdeploy.login.ssh.target import SshTarget

IMPATIENT = SshTimeouts(login_s=0.7)
HANGS = SshTimeouts(login_s=20.0, beat_s=0.1, silence_s=0.5)


@pytest.fixture
def key(tmp_path: Path) -> Path:
    path = tmp_path / "own"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(path)], check=True)
    return path


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    with Machines.open(tmp_path) as machines:
        yield machines


def target_of(server: Server, key: Path) -> SshTarget:
    return SshTarget(server.address, server.port, USER, (str(key),), (server.known,))


def fail(target: SshTarget, timeouts: SshTimeouts = IMPATIENT) -> ReachError:
    with ExitStack() as closer, pytest.raises(ReachError) as caught:
        connect(target, closer, timeouts)
    return caught.value


@pytest.mark.parametrize("reach", LoginFault)
def test_an_error_survives_pickling_with_its_cause(reach: LoginFault) -> None:
    error = copy(ReachError("head: closed", "open it", reach))  # by way of what pickle uses
    assert (str(error), error.reach, error.exit_code) == ("head: closed; open it", reach, 4)


CAUSES = {
    "silent": (LoginFault.SILENT, "sends no greeting"),
    "slow": (LoginFault.SILENT, "sends no whole greeting"),
    "endless": (LoginFault.NOT_SSH, "says 'AAAA"),
    "lines": (LoginFault.NOT_SSH, "says 'welcome, stranger'"),
    "binary": (LoginFault.NOT_SSH, r"says '\x16\x03\x01\x1b[2J\xff\xfe'"),
    "web": (LoginFault.NOT_SSH, "says 'HTTP/1.1 400 Bad Request'"),
    "shut": (LoginFault.NOT_SSH, "closes the connection with no greeting"),
    "old": (LoginFault.NOT_SSH, "Incompatible version"),
    "frozen": (LoginFault.SILENT, "in the middle of the handshake"),
    "garbage": (LoginFault.NOT_SSH, "greets as SSH and then breaks its rules"),
    "flood": (LoginFault.NOT_SSH, "says more than any login needs"),
}


@pytest.mark.parametrize("name", ACTS)
def test_a_bad_server_is_named_in_time_and_nothing_else_is_printed(
    name: str, key: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    reach, words = CAUSES[name]
    with open_rude(ACTS[name]) as port:
        error = fail(SshTarget("127.0.0.1", port, "me", (str(key),)))
    assert (error.reach, words in error.problem) == (reach, True), str(error)
    assert f"127.0.0.1:{port}" in error.problem
    assert error.advice
    assert "\n" not in str(error)
    assert capfd.readouterr().err == ""


def test_a_machine_that_is_stopped_is_not_said_to_deny_permission(tmp_path: Path) -> None:
    server, port = start_sshd(tmp_path, tmp_path)
    try:
        server.send_signal(signal.SIGSTOP)
        error = fail(SshTarget("127.0.0.1", port, getpass.getuser(), (str(tmp_path / "login"),)))
    finally:
        server.send_signal(signal.SIGCONT)
        server.terminate()
        server.communicate()
    assert error.reach is LoginFault.SILENT
    assert "the machine hangs" in error.problem


def test_nobody_at_a_port_is_unreachable(key: Path) -> None:
    with open_rude(ACTS["shut"]) as port:
        pass
    error = fail(SshTarget("127.0.0.1", port, "me", (str(key),)))
    assert (error.reach, "connection refused" in error.problem) == (LoginFault.UNREACHABLE, True)
    assert "security group" in error.advice


def test_a_name_that_nobody_knows_is_unreachable(key: Path) -> None:
    for name in ("nobody.invalid", "x" * 70, "a..b"):
        error = fail(SshTarget(name, 22, "me", (str(key),)), SshTimeouts(login_s=20.0))
        assert (error.reach, "no such host name" in error.problem) == (LoginFault.UNREACHABLE, True)


def test_the_four_refusals_of_a_machine_that_is_up_are_told_apart(
    machines: Machines, key: Path, tmp_path: Path
) -> None:
    server, other = machines.add(), machines.add()
    good = target_of(server, key)
    error = fail(good, SshTimeouts())
    assert error.reach is LoginFault.KEY_REFUSED
    assert str(key) in error.problem
    own = replace(good, host_keys=(), known_hosts=(str(tmp_path / "known"),))
    error = fail(own, SshTimeouts())
    assert error.reach is LoginFault.HOST_KEY_UNKNOWN
    assert f"run ssh -p {server.port} {USER}@{server.address} once" in error.advice
    (tmp_path / "known").write_text(f"[{server.address}]:{server.port} {other.host_line}\n")
    error = fail(own, SshTimeouts())
    assert error.reach is LoginFault.HOST_KEY_CHANGED
    assert f"ssh-keygen -R '[{server.address}]:{server.port}'" in error.advice
    (tmp_path / "known").write_text(f"[{server.address}]:{server.port} {server.host_line}\n")
    error = fail(own, SshTimeouts())
    assert (error.reach, "ssh-copy-id" in error.advice) == (LoginFault.KEY_REFUSED, True)
    lock(key)
    error = fail(own, SshTimeouts())
    assert (error.reach, error.advice) == (LoginFault.PASSPHRASE_NEEDED, f"run ssh-add {key}")


def lock(key: Path, *more: str) -> None:
    subprocess.run(
        ["ssh-keygen", "-q", "-p", "-P", "", "-N", "sesame", *more, "-f", str(key)], check=True
    )


KINDS = [
    (kind, form)
    for kind in ("ed25519", "rsa", "ecdsa")
    for form in ("RFC4716", "PEM", "PKCS8")
    if (kind, form) not in {("ed25519", "PEM"), ("ed25519", "PKCS8")}
]


@pytest.mark.parametrize(("kind", "form"), KINDS)
def test_a_passphrase_is_seen_before_any_machine_is_asked_for_every_kind_of_key(
    kind: str, form: str, tmp_path: Path
) -> None:
    path = tmp_path / "locked"
    command = ["ssh-keygen", "-q", "-t", kind, "-m", form, "-N", "sesame", "-f", str(path)]
    subprocess.run(command, check=True)
    for read in (read_key, public_key):
        with pytest.raises(ReachError) as caught:
            read(path)
        assert caught.value.reach is LoginFault.PASSPHRASE_NEEDED
    error = fail(SshTarget("nobody.invalid", 22, "me", (str(path),)))
    assert error.reach is LoginFault.PASSPHRASE_NEEDED


@pytest.fixture
def agent(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """The user's agent, empty."""
    place = str(tmp_path / "agent")
    with subprocess.Popen(["ssh-agent", "-D", "-a", place], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()  # it listens
        monkeypatch.setenv("SSH_AUTH_SOCK", place)
        yield
        process.terminate()


@pytest.mark.usefixtures("agent")
@pytest.mark.parametrize("has_public_file", [True, False])
def test_an_agent_that_holds_a_locked_key_is_used(
    machines: Machines, key: Path, has_public_file: bool
) -> None:
    server = machines.add()
    server.keys.append(public_key(key))
    expected = public_key(key)
    subprocess.run(["ssh-add", "-q", str(key)], check=True)
    lock(key)
    if not has_public_file:
        key.with_name(key.name + ".pub").unlink()
    assert public_key(key) == expected
    with ExitStack() as closer:
        assert connect(target_of(server, key), closer).is_authenticated()


def test_a_file_that_is_no_key_is_named(tmp_path: Path) -> None:
    (tmp_path / "none").write_text("no key\n")
    with ExitStack() as closer, pytest.raises(Exception, match=r"none: the SSH key cannot be read"):
        find_identities([str(tmp_path / "none")], are_own=False, closer=closer)


class Frozen:
    """A real SSH server whose processes stop while a shell on it is open."""

    def __init__(self, shell: SshShell) -> None:
        self.shell = shell
        self.session = int(shell.run("echo $PPID").output)

    def stop(self) -> None:
        os.kill(self.session, signal.SIGSTOP)


@pytest.fixture
def frozen(tmp_path: Path) -> Iterator[Frozen]:
    with open_sshd(tmp_path) as target, ExitStack() as closer:
        connection = connect(target, closer, HANGS)
        with SshShell("worker-1", connection, closer.pop_all()) as shell:
            frozen = Frozen(shell)
            try:
                yield frozen
            finally:
                os.kill(frozen.session, signal.SIGKILL)


def test_a_command_on_a_machine_that_freezes_ends(frozen: Frozen) -> None:
    def stop(line: str) -> None:
        frozen.stop()

    with pytest.raises(ReachError, match=r"worker-1: it has not answered for 0 s"):
        frozen.shell.follow("echo up; tail -f /dev/null", stop)


def test_a_file_to_a_machine_that_freezes_ends(frozen: Frozen, tmp_path: Path) -> None:
    (tmp_path / "source").write_bytes(bytes(50_000_000))

    def stop(done: int, size: int) -> None:
        if done > 1_000_000:
            frozen.stop()

    with pytest.raises(ReachError, match="worker-1"):
        frozen.shell.put(tmp_path / "source", str(tmp_path / "there"), on_progress=stop)


def test_a_command_that_says_nothing_on_a_machine_that_lives_goes_on(frozen: Frozen) -> None:
    assert frozen.shell.run("sleep 1.5; echo done").output == "done\n"


def jumped(machines: Machines, key: Path, inside: SshTarget) -> SshTarget:
    gate = machines.add()
    gate.keys.append(public_key(key))
    return replace(inside, jumps=(target_of(gate, key),))


def test_on_the_way_the_machine_that_fails_is_named(machines: Machines, key: Path) -> None:
    server = machines.add()
    target = jumped(machines, key, target_of(server, key))
    machines.stop(server)
    error = fail(target, SshTimeouts())
    assert (error.reach, server.address in error.problem) == (LoginFault.UNREACHABLE, True)
    gate = target.jumps[0]
    error = fail(replace(target, jumps=(replace(gate, user="stranger"),)), SshTimeouts())
    assert error.reach is LoginFault.KEY_REFUSED
    assert f"on the way, at {gate.place}" in error.problem


@pytest.mark.slow
@pytest.mark.parametrize("name", ["silent", "endless", "web", "frozen"])
def test_a_bad_server_behind_a_jump_is_named_too(
    name: str, machines: Machines, key: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with open_rude(ACTS[name]) as port:
        target = jumped(machines, key, SshTarget("127.0.0.1", port, "me", (str(key),)))
        error = fail(target, SshTimeouts(login_s=3.0))
    assert error.reach is CAUSES[name][0]
    assert capfd.readouterr().err == ""


def test_a_jump_that_goes_ends_what_is_behind_it_without_a_word(
    machines: Machines, key: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    server = machines.add()
    server.keys.append(public_key(key))
    target = jumped(machines, key, target_of(server, key))
    with ExitStack() as closer:
        connection = connect(target, closer)
        with SshShell("worker-1", connection, closer.pop_all()) as shell:
            machines.stop(machines.servers[-1])
            with pytest.raises(ReachError, match="worker-1"):
                shell.run("true")
            connection.join(20)
    assert isinstance(connection, SshConnection)
    assert not connection.is_alive()
    assert capfd.readouterr().err == ""
