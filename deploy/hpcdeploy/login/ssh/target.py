"""Where a machine is and who we are there: from the cluster file, the cloud and ~/.ssh/config."""

from __future__ import annotations

import re
from dataclasses import replace

import paramiko

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ConfigError
from hpccomponent.files.paths import expand_home, home_folder
from hpcdeploy.login.ssh.keys import own_key_files
from hpcdeploy.spec.cluster import Auth
from hpcdeploy.spec.provider import JUMP, Host

_JUMP = re.compile(JUMP)


@dataclass(frozen=True, slots=True)
class SshTarget:
    """A machine to log in to.

    Parameters
    ----------
    key_files : tuple of str
        Private keys; with none, the user's own in ``~/.ssh`` are tried, and the agent's.
    host_keys : tuple of paramiko.PKey
        Those that it may have; with none, the ones in `known_hosts`.
    known_hosts : tuple of str
        Files of the user's own.
    host_key_name : str
        What it is called there, where not by its address.
    jumps : tuple of SshTarget
        Machines on the way, the nearest first.
    name : str
        What the user calls it, where not by its address.
    """

    address: str
    port: int
    user: str
    key_files: tuple[str, ...] = ()
    host_keys: tuple[paramiko.PKey, ...] = ()
    known_hosts: tuple[str, ...] = ()
    host_key_name: str = ""
    jumps: tuple[SshTarget, ...] = ()
    name: str = ""

    @property
    def place(self) -> str:
        """Address and port, for messages."""
        address = f"[{self.address}]" if ":" in self.address else self.address
        return f"{address}:{self.port}"

    @property
    def called(self) -> str:
        """The user's own name of it."""
        return self.name or self.address

    @property
    def command(self) -> str:
        """The command with which a user logs in by hand."""
        jumps = ",".join(f"{jump.user}@{jump.place}" for jump in self.jumps)
        way = f"-J {jumps} " if jumps else ""
        port = f"-p {self.port} " if self.port != 22 else ""
        return f"ssh {way}{port}{self.user}@{self.called}"

    @property
    def known_as(self) -> str:
        """The name of its host key, as ``known_hosts`` files write it."""
        if self.host_key_name or self.port == 22:
            return self.host_key_name or self.address
        return f"[{self.address}]:{self.port}"


def host_id(host: Host) -> str:
    """Return what tells a host of the cluster file from the others."""
    return host.address if host.port is None else f"{host.address}:{host.port}"


def host_address(host: Host) -> str:
    """Return the address of a host, following ``~/.ssh/config``."""
    return str(_read_config().lookup(host.address).get("hostname", host.address))


def host_target(host: Host, auth: Auth, key_files: tuple[str, ...]) -> SshTarget:
    """Return how a host of the cluster file is reached, following ``~/.ssh/config``.

    The user and port of `auth` are used where neither the host nor the configuration has one.
    `key_files` are the file's own; by default the configuration's.
    """
    config = _read_config()
    target = _resolve(config, host.address, host.user or "", host.port, auth, key_files)
    if auth.proxy_jumps:
        return replace(target, jumps=jump_targets(auth, key_files))
    jumps = config.lookup(host.address).get("proxyjump", "none")
    names = [] if jumps.lower() == "none" else jumps.split(",")
    return replace(
        target,
        jumps=tuple(_resolve_jump(config, name.strip(), auth, key_files) for name in names),
    )


def jump_targets(auth: Auth, key_files: tuple[str, ...] = ()) -> tuple[SshTarget, ...]:
    """Return the machines on the way that the cluster file names, the nearest first.

    They are the user's own: their host keys are in the user's ``known_hosts``, and the user's keys
    let in, as ``~/.ssh/config`` says; `key_files` are tried first.
    """
    if not auth.proxy_jumps:
        return ()
    config = _read_config()
    return tuple(_resolve_jump(config, jump, auth, key_files) for jump in auth.proxy_jumps)


def _read_config() -> paramiko.SSHConfig:
    path = home_folder() / ".ssh/config"
    try:
        return paramiko.SSHConfig.from_path(str(path))
    except FileNotFoundError:
        return paramiko.SSHConfig()
    except (OSError, UnicodeDecodeError, paramiko.ConfigParseError) as error:
        raise ConfigError(f"{path}: {error}", "correct the file, which ssh reads too") from error


def _resolve_jump(
    config: paramiko.SSHConfig, jump: str, auth: Auth, key_files: tuple[str, ...]
) -> SshTarget:
    """Return the target of a ProxyJump's ``[USER@]HOST[:PORT]``; its own jumps do not count."""
    match = _JUMP.fullmatch(jump)
    if match is None:
        raise ConfigError(f"{jump!r} is no [USER@]HOST[:PORT] to jump over", "correct ProxyJump")
    user, bracketed, plain, port = match.group("user", "address", "name", "port")
    name = bracketed or plain
    target = _resolve(config, name, user or "", int(port) if port else None, auth, ())
    own_files = target.key_files or own_key_files()
    return replace(target, key_files=(*key_files, *own_files))


def _resolve(
    config: paramiko.SSHConfig,
    name: str,
    user: str,
    port: int | None,
    auth: Auth,
    key_files: tuple[str, ...],
) -> SshTarget:
    options = config.lookup(name)
    files = options.get("userknownhostsfile", "~/.ssh/known_hosts").split()
    return SshTarget(
        address=options.get("hostname", name),
        port=port or int(options.get("port", auth.ssh_port)),
        user=user or options.get("user", auth.ssh_user),
        key_files=key_files or tuple(map(_home, options.get("identityfile", ()))),
        known_hosts=tuple(map(_home, files)),
        host_key_name=options.get("hostkeyalias", ""),
        name=name,
    )


def _home(file: str) -> str:
    return str(expand_home(file))
