"""The way to the machines of a cluster: its SSH key, its pinned host keys, and shells."""

from __future__ import annotations

import base64
import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from pathlib import Path

import paramiko

from hpccomponent.errors import CloudError
from hpccomponent.files.paths import expand_home
from hpccomponent.protocol.keys import KeyPair
from hpcdeploy.login.host_keys import HostKeys, parse_console
from hpcdeploy.login.local_shell import LocalShell
from hpcdeploy.login.shell import Shell
from hpcdeploy.login.ssh.connect import connect
from hpcdeploy.login.ssh.connection import SshTimeouts
from hpcdeploy.login.ssh.keys import public_key
from hpcdeploy.login.ssh.reach import LoginFault, ReachError
from hpcdeploy.login.ssh.shell import SshShell
from hpcdeploy.login.ssh.target import SshTarget, host_id, host_target, jump_targets
from hpcdeploy.ownership.journal import peek_journal
from hpcdeploy.ownership.node_keys import NodeKeys
from hpcdeploy.ownership.ownership import Ownership, cloud_fingerprints, fingerprint
from hpcdeploy.provider import MachineSeen, Provider
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.layout import state_folder
from hpcdeploy.spec.names import Owner, this_user
from hpcdeploy.spec.polling import utc_now

log = logging.getLogger("hpcapp")

HOPELESS = (
    LoginFault.HOST_KEY_UNKNOWN,
    LoginFault.HOST_KEY_CHANGED,
    LoginFault.NO_KEY,
    LoginFault.PASSPHRASE_NEEDED,
)
"""What no further attempt changes."""
KNOWN_S = 25.0
"""A machine that was set up before has booted: it lets us in so soon, or not at all."""
DENIED_S = 60.0  # an image's SSH server answers before the key is installed
RETRY_S = 1.0
TOLD_S = 3.0  # before a wait is told
LAST_S = 1.0  # an attempt has so long at least
KEY_BITS = 2048  # RSA, of 1024, 2048 or 4096 bits: a Eucalyptus imports nothing else
CONSOLE_LINES = 5


class Access:
    """Opens shells on the machines of one cluster; safe to use from several threads."""

    def __init__(self, spec: ClusterSpec, base: Path, provider: Provider) -> None:
        self.base = base
        self._spec = spec
        self._provider = provider
        self._folder = state_folder(spec.cluster)
        self._host_keys = HostKeys(self._folder / "known_hosts")
        self._closing = threading.Event()
        self._lock = threading.Lock()
        self._key: Path | None = None
        self._shells: list[Shell] = []

    def public_key(self) -> str:
        """Return the public half of the cluster's SSH key, in OpenSSH's form; made on first use.

        Raises CloudError where it cannot be read or made, or is locked and in no agent.
        """
        return public_key(self._key_file(is_made=True))

    def ownership(self) -> Ownership:
        """Return what this machine holds of the cluster; nothing is made.

        A cloud's machines let in whoever has the cluster's SSH key. Hosts let in their users'
        own keys; there the key is that of the cluster's master, which no other user has.
        """
        lives = peek_journal(self._spec.cluster).lives
        if not self._spec.provider.makes_machines:
            pair = NodeKeys.read(self._folder / "keys.json")
            return Ownership(Owner(this_user(), _curve_print(pair) if pair else ""), lives=lives)
        path = self._key_file()
        if self._spec.auth.ssh_private_key == "auto" and not path.exists():
            return Ownership(Owner(this_user()), lives=lives)
        key = public_key(path)
        return Ownership(Owner(this_user(), fingerprint(key)), cloud_fingerprints(key), lives)

    def owner(self) -> Owner:
        """Return us as the owner of what is made; the key is made on first use."""
        if self._spec.provider.makes_machines:
            return Owner(this_user(), fingerprint(self.public_key()))
        return Owner(this_user(), _curve_print(NodeKeys(self._folder / "keys.json", ()).server))

    def use_key(self, path: Path) -> None:
        """Log in with a key that is not the cluster's yet."""
        self._key = path

    def open(self, machine: MachineSeen, timeout_s: float | None = None) -> Shell:
        """Open a shell on a machine; it is closed with this object at the latest.

        A cloud's machine is waited for `timeout_s` seconds until it answers; by default
        `limits.boot` from its launch, and `KNOWN_S` where that is over or it was set up before. A
        host is there, so that for it this is the limit of one attempt. Raises ReachError, with why
        it does not let us in.
        """
        shell = self._open(machine, timeout_s)
        with self._lock:
            self._shells.append(shell)
            is_late = self._closing.is_set()
        if is_late:
            shell.close()
            raise _given_up(machine)
        return shell

    def close(self) -> None:
        """Close every shell that is still open, and give up waiting for machines."""
        self._closing.set()
        with self._lock:
            shells, self._shells = self._shells, []
        for shell in shells:
            shell.close()

    def _open(self, machine: MachineSeen, timeout_s: float | None) -> Shell:
        if self._spec.provider.is_here:
            return LocalShell(machine.name.node, Path(machine.id))
        if not self._spec.provider.makes_machines:
            return self._open_host(machine, timeout_s)
        limit_s = self._boot_left_s(machine) if timeout_s is None else timeout_s
        wait = f"{machine.name.node}: waiting until it lets us in, {limit_s:.0f} s at most"
        with _told_late(wait):
            return self._wait_for(machine, time.monotonic() + limit_s)

    def _boot_left_s(self, machine: MachineSeen) -> float:
        """Return how long a machine may still take until it lets us in."""
        if machine.id in peek_journal(self._spec.cluster).set_up:
            return KNOWN_S
        age = utc_now() - machine.launched if machine.launched is not None else timedelta()
        return max(KNOWN_S, self._spec.limits.boot - age.total_seconds())

    def _open_host(self, machine: MachineSeen, timeout_s: float | None) -> Shell:
        """Log in to a host that the file names: it is there, so that one attempt tells."""
        hosts = self._spec.provider.fixed_hosts
        [host] = [host for host in hosts if host_id(host) == machine.id]
        auth = self._spec.auth
        files = () if auth.ssh_private_key == "auto" else (str(self._key_file()),)
        limit_s = SshTimeouts().login_s if timeout_s is None else timeout_s
        try:
            return _log_in(machine, host_target(host, auth, files), limit_s)
        except ReachError as error:
            where = f"{machine.name.node} ({machine.id})"
            raise ReachError(f"{where}: {error.problem}", error.advice, error.reach) from error

    def _key_file(self, *, is_made: bool = False) -> Path:
        """Return the file of the private key, and make it, if it is to be, where there is none."""
        if self._key is not None:
            return self._key
        name = self._spec.auth.ssh_private_key
        if name != "auto":
            return self.base / expand_home(name)
        path = self._folder / "id"
        with self._lock:
            if is_made and not path.exists():
                _make_key(path)
        return path

    def _wait_for(self, machine: MachineSeen, deadline: float) -> Shell:
        """Try until the machine lets us in, its time is over, or trying is no use."""
        denied_since: float | None = None
        while True:
            try:
                shell = self._try(machine, deadline)
                if shell is not None:
                    return shell
                error = ReachError("it has not printed its host keys on its console yet")
            except ReachError as refused:
                error = refused
                if error.reach in HOPELESS:
                    raise self._unreachable(machine, error) from error
                if error.reach is LoginFault.KEY_REFUSED:
                    denied_since = denied_since or time.monotonic()
                    deadline = min(deadline, denied_since + DENIED_S)
            if time.monotonic() >= deadline:
                raise self._unreachable(machine, error) from error
            if self._closing.wait(RETRY_S):
                raise _given_up(machine)

    def _try(self, machine: MachineSeen, deadline: float) -> Shell | None:
        """Log in to a cloud's machine; None while its host keys are not known."""
        key_file = self._key_file()
        if not key_file.exists():
            raise CloudError(
                f"{machine.name.node} ({machine.id}): there is no key of cluster "
                f"{self._spec.cluster} here ({key_file})",
                "put its owner's key there, or see hpcapp adopt",
            )
        keys = self._host_keys.find(machine.id)
        if not keys:
            printed = parse_console(self._provider.console(machine))
            if not printed:
                return None
            self._host_keys.pin(machine.id, printed)
            keys = self._host_keys.find(machine.id)
        target = SshTarget(
            address=self._address(machine),
            port=self._spec.auth.ssh_port,
            user=self._spec.auth.ssh_user,
            key_files=(str(key_file),),
            host_keys=tuple(keys),
            host_key_name=machine.id,
            jumps=jump_targets(
                self._spec.auth,
                () if self._spec.auth.ssh_private_key == "auto" else (str(key_file),),
            ),
        )
        limit_s = min(SshTimeouts().login_s, max(LAST_S, deadline - time.monotonic()))
        return _log_in(machine, target, limit_s)

    def _address(self, machine: MachineSeen) -> str:
        return machine.address(self._spec.provider.address_kind)

    def _unreachable(self, machine: MachineSeen, error: ReachError) -> ReachError:
        address = self._address(machine) or "no address"
        lines = self._provider.console(machine).strip().splitlines()[-CONSOLE_LINES:]
        console = "its console ends so" if lines else "its console is empty"
        advice = error.advice or "see auth in the cluster file, and the image"
        return ReachError(
            f"{machine.name.node} ({machine.id}, {address}): {error.problem}",
            f"{advice}; {console}",
            error.reach,
            "\n".join(lines),
        )


def _curve_print(pair: KeyPair) -> str:
    return fingerprint(f"curve {base64.b64encode(pair.public.encode()).decode()}")


def _log_in(machine: MachineSeen, target: SshTarget, limit_s: float) -> SshShell:
    with ExitStack() as closer:
        connection = connect(target, closer, SshTimeouts(login_s=limit_s))
        return SshShell(machine.name.node, connection, closer.pop_all())


@contextmanager
def _told_late(wait: str) -> Iterator[None]:
    """Say what is waited for once that takes a while."""
    timer = threading.Timer(TOLD_S, log.info, (wait,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()


def _given_up(machine: MachineSeen) -> ReachError:
    return ReachError(f"{machine.name.node}: no longer waited for")


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
