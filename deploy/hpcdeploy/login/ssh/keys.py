"""The private keys that we log in with: from files, from the user's agent; where a passphrase is.

The one place that reads private keys. Whether a file is locked is told by the library that
decrypts it, for every kind of key and every form of the file alike.
"""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Sequence
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path

import paramiko
from cryptography.exceptions import UnsupportedAlgorithm
from paramiko.pkey import UnknownKeyType

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError
from hpccomponent.files.paths import home_folder
from hpcdeploy.login.ssh.reach import LoginFault, ReachError

_OWN = ("id_ed25519", "id_ecdsa", "id_rsa")
_MAGIC = b"openssh-key-v1\0"


@dataclass(frozen=True, slots=True, eq=False)
class Identity:
    """A key that can sign."""

    key: paramiko.PKey
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class Identities:
    """What a login may be tried with.

    `usable` are in the order in which they are offered; `unusable` say why further keys are not,
    those with a passphrase first.
    """

    usable: tuple[Identity, ...]
    unusable: tuple[CloudError, ...] = ()


def read_key(path: Path) -> paramiko.PKey:
    """Read a private key that has no passphrase.

    Raises ReachError where it has one, CloudError where it is not there, or is no key.
    """
    try:
        stat = path.stat()
        return _parse(path, (stat.st_ino, stat.st_size, stat.st_mtime_ns))
    except (TypeError, paramiko.PasswordRequiredException) as error:
        # TypeError is how cryptography says that a password is missing
        raise ReachError(
            f"{LoginFault.PASSPHRASE_NEEDED}: the private key {path} has a passphrase, and no SSH "
            "agent holds it",
            f"run ssh-add {path}",
            LoginFault.PASSPHRASE_NEEDED,
        ) from error
    except (OSError, ValueError, paramiko.SSHException) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is damaged, or no key"
        raise _unreadable(path, str(reason)) from error
    except (UnsupportedAlgorithm, UnknownKeyType) as error:
        raise _unreadable(path, "of a kind that is not supported") from error


def _unreadable(path: Path, reason: str) -> CloudError:
    return CloudError(
        f"{path}: the SSH key cannot be read ({reason})",
        "name an RSA, ECDSA or Ed25519 private key as auth.ssh_private_key, or use auto",
    )


@lru_cache(maxsize=64)
def _parse(path: Path, stamp: tuple[int, int, int]) -> paramiko.PKey:
    """Parse a file once: an RSA key is checked for longer than a login takes."""
    del stamp  # another file under the same name is parsed anew
    return paramiko.PKey.from_path(path)


def public_key(path: Path) -> str:
    """Return the public half of a private key that we can log in with, in OpenSSH's form.

    Where it has a passphrase, the agent must hold it.
    """
    with ExitStack() as closer:
        try:
            key = read_key(path)
        except ReachError:
            agent_key = _find_agent_key(path, _agent_keys(closer))
            if agent_key is None:
                raise
            key = agent_key
        return f"{key.get_name()} {key.get_base64()}"


def find_identities(files: Sequence[str], *, are_own: bool, closer: ExitStack) -> Identities:
    """Return the keys to log in with, without asking the machine.

    `files` are private keys; those that have a passphrase are taken from the agent. With `are_own`
    all keys of the agent are offered too and, without `files`, those in ``~/.ssh``. `closer` closes
    the agent, which signs as long as it is open. Raises ReachError or CloudError where there is
    none of use.
    """
    agent_keys = _agent_keys(closer) if are_own else []
    usable: list[Identity] = []
    locked: list[CloudError] = []
    broken: list[CloudError] = []
    paths = [Path(file) for file in files]
    if are_own and not paths:
        paths = [Path(file) for file in own_key_files()]
    for path in paths:
        try:
            usable.append(Identity(read_key(path), str(path)))
        except ReachError as error:
            agent_keys = agent_keys or _agent_keys(closer)
            key = _find_agent_key(path, agent_keys)
            if key is None:
                locked.append(error)
            else:
                usable.append(Identity(key, f"{path} (of the agent)"))
        except CloudError as error:
            broken.append(error)
    if are_own:
        offered = {identity.key.asbytes() for identity in usable}
        usable += [Identity(key, "the agent") for key in agent_keys if key.asbytes() not in offered]
    if usable:
        return Identities(tuple(usable), (*locked, *broken))
    for cause in (*locked, *broken):
        raise cause
    raise ReachError(
        f"{LoginFault.NO_KEY}: there is none in ~/.ssh, and none in an agent",
        "make one with ssh-keygen, and bring it there with ssh-copy-id",
        LoginFault.NO_KEY,
    )


def own_key_files() -> tuple[str, ...]:
    """Return the user's private keys where ssh looks for them too."""
    files = (home_folder() / ".ssh" / name for name in _OWN)
    return tuple(str(file) for file in files if file.exists())


def _agent_keys(closer: ExitStack) -> list[paramiko.PKey]:
    """Return what the user's agent holds; nothing where none runs."""
    try:
        agent = paramiko.Agent()
    except (OSError, paramiko.SSHException):
        return []
    closer.callback(agent.close)
    return list(agent.get_keys())


def _find_agent_key(path: Path, agent_keys: Sequence[paramiko.PKey]) -> paramiko.PKey | None:
    """Return the agent's key of a locked file."""
    blob = _public_blob(path)
    return next((key for key in agent_keys if key.asbytes() == blob), None)


def _public_blob(path: Path) -> bytes | None:
    """Return the public half of a locked file: OpenSSH writes it beside, and in clear into it."""
    try:
        return base64.b64decode(path.with_name(path.name + ".pub").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        pass  # the file itself may hold it
    try:
        lines = path.read_text().strip().splitlines()
        text = base64.b64decode("".join(lines[1:-1]))
        if not text.startswith(_MAGIC):
            return None
        at = len(_MAGIC)
        for _ in range(3):  # the cipher, the derivation of its key and that one's options
            at += 4 + struct.unpack_from(">I", text, at)[0]
        at += 4  # how many keys there are
        (size,) = struct.unpack_from(">I", text, at)
        return text[at + 4 : at + 4 + size]
    except (OSError, ValueError, binascii.Error, struct.error):
        return None
