"""The way to the machines of a cluster: its SSH key, its pinned host keys, and shells."""

from __future__ import annotations

import os
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import paramiko
from paramiko.pkey import UnknownKeyType

from hpccomponent.errors import CloudError
from hpcdeploy.host_keys import HostKeys, parse_console
from hpcdeploy.layout import state_folder
from hpcdeploy.local_shell import LocalShell
from hpcdeploy.provider import MachineSeen, Provider
from hpcdeploy.provider_spec import LocalSpec, SshSpec
from hpcdeploy.shell import Shell
from hpcdeploy.spec import ClusterSpec
from hpcdeploy.ssh import SshShell
from hpcdeploy.ssh_connect import HostKeyError, connect, explain
from hpcdeploy.ssh_target import Target, host_id, host_target

__all__ = ["Access", "make_access"]

DENIED_S = 60.0  # an image's SSH server answers before the key is installed
RETRY_S = 1.0
KEY_BITS = 2048  # RSA, of 1024, 2048 or 4096 bits: a Eucalyptus imports nothing else
CONSOLE_LINES = 5


class Access:
    """Opens shells on the machines of one cluster; safe to use from several threads.

    Parameters
    ----------
    spec : ClusterSpec
    base : Path
        The folder of the cluster file, which its paths are relative to.
    provider : Provider
        Whose console shows the host keys.
    """

    def __init__(self, spec: ClusterSpec, base: Path, provider: Provider) -> None:
        self.base = base
        self._spec = spec
        self._provider = provider
        self._folder = state_folder(spec.cluster)
        self._host_keys = HostKeys(self._folder / "known_hosts")
        self._closing = threading.Event()
        self._lock = threading.Lock()
        self._shells: list[Shell] = []

    def public_key(self) -> str:
        """Return the public half of the cluster's SSH key, in OpenSSH's form; made on first use.

        Raises
        ------
        CloudError
            The key cannot be read or made.
        """
        path = self._key_file()
        try:
            key = paramiko.PKey.from_path(path)
        except (OSError, ValueError, paramiko.SSHException, UnknownKeyType) as error:
            raise CloudError(
                f"{path}: the SSH key cannot be read ({explain(error)})",
                "name a private key without a passphrase as auth.ssh_private_key, or use auto",
            ) from error
        return f"{key.get_name()} {key.get_base64()}"

    def open(self, machine: MachineSeen, timeout_s: float | None = None) -> Shell:
        """Open a shell on a machine, and wait until it answers, by default for `limits.boot`.

        Raises
        ------
        CloudError
            It did not answer in time, or its host key is not the pinned one.
        """
        shell = self._open(machine, self._spec.limits.boot if timeout_s is None else timeout_s)
        with self._lock:
            self._shells.append(shell)
        return shell

    def close(self) -> None:
        """Close every shell that is still open, and give up waiting for machines."""
        self._closing.set()
        with self._lock:
            shells, self._shells = self._shells, []
        for shell in shells:
            shell.close()

    def _open(self, machine: MachineSeen, timeout_s: float) -> Shell:
        node = machine.name.node
        match self._spec.provider:
            case LocalSpec():
                return LocalShell(node, Path(machine.id))
            case SshSpec(hosts=hosts):
                [host] = [host for host in hosts if host_id(host) == machine.id]
                auth = self._spec.auth
                is_auto = auth.ssh_private_key == "auto"
                files = () if is_auto else (str(self._key_file()),)
                return self._log_in(machine, host_target(host, auth, files))
        return self._wait_for(machine, time.monotonic() + timeout_s)

    def _key_file(self) -> Path:
        """Return the file of the private key, and make it where there is none."""
        name = self._spec.auth.ssh_private_key
        if name != "auto":
            return self.base / Path(name).expanduser()
        path = self._folder / "id"
        with self._lock:
            if not path.exists():
                _make_key(path)
        return path

    def _wait_for(self, machine: MachineSeen, deadline: float) -> Shell:
        """Try until the machine lets us in, its time is over, or trying is no use."""
        denied_since: float | None = None
        while True:
            try:
                reason, shell = "", self._try(machine)
                if shell is not None:
                    return shell
                reason = "it has not printed its host keys on its console yet"
            except HostKeyError as error:
                raise self._unreachable(machine, explain(error)) from error
            except (OSError, EOFError, paramiko.SSHException) as error:
                reason = explain(error)
                if isinstance(error, paramiko.AuthenticationException):
                    denied_since = denied_since or time.monotonic()
                    deadline = min(deadline, denied_since + DENIED_S)
            if time.monotonic() >= deadline:
                raise self._unreachable(machine, reason)
            if self._closing.wait(RETRY_S):
                raise CloudError(f"{machine.name.node}: no longer waited for")

    def _try(self, machine: MachineSeen) -> Shell | None:
        """Log in to a cloud's machine; None while its host keys are not known."""
        keys = self._host_keys.find(machine.id)
        if not keys:
            printed = parse_console(self._provider.console(machine))
            if not printed:
                return None
            self._host_keys.pin(machine.id, printed)
            keys = self._host_keys.find(machine.id)
        target = Target(
            address=machine.public_address or machine.private_address,
            port=self._spec.auth.ssh_port,
            user=self._spec.auth.ssh_user,
            key_files=(str(self._key_file()),),
            host_keys=tuple(keys),
            host_key_name=machine.id,
        )
        return _connected(machine.name.node, target)

    def _log_in(self, machine: MachineSeen, target: Target) -> Shell:
        """Log in to a machine that is there, so that one attempt tells."""
        try:
            return _connected(machine.name.node, target)
        except HostKeyError as error:
            raise CloudError(
                f"{machine.name.node} ({machine.id}): {explain(error)}",
                f"run ssh {machine.id} once and compare the fingerprint",
            ) from error
        except (OSError, EOFError, paramiko.SSHException) as error:
            raise CloudError(
                f"{machine.name.node} ({machine.id}): {explain(error)}",
                f"make 'ssh {machine.id}' work without a password",
            ) from error

    def _unreachable(self, machine: MachineSeen, reason: str) -> CloudError:
        address = machine.public_address or machine.private_address or "no address"
        lines = self._provider.console(machine).strip().splitlines()[-CONSOLE_LINES:]
        console = "its console ends so" if lines else "its console is empty"
        return CloudError(
            f"{machine.name.node} ({machine.id}, {address}): {reason}",
            f"see auth in the cluster file, and the image; {console}",
            "\n".join(lines),
        )


def make_access(spec: ClusterSpec, base: Path, provider: Provider) -> Access:
    """Return the way to the machines of a cluster."""
    return Access(spec, base, provider)


def _connected(node: str, target: Target) -> SshShell:
    with ExitStack() as closer:
        client = connect(target, closer)
        return SshShell(node, client, closer.pop_all())


def _make_key(path: Path) -> None:
    """Make a private key, readable by its owner only; of two hurried makers the first one wins."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    beside = path.with_name(f".id.{os.getpid()}")
    key = paramiko.RSAKey.generate(KEY_BITS)
    try:
        with open(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
            key.write_private_key(stream)
        os.link(beside, path)
    except FileExistsError:
        return
    finally:
        beside.unlink(missing_ok=True)
