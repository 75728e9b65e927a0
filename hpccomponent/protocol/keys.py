"""CURVE key pairs, one for the master and one for every worker, and the files that hold secrets.

These are of mode 0600, written whole, and read only where nobody else can read them.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Collection
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any

import zmq
from msgspec import Meta

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ConfigError, OutputError
from hpccomponent.files.paths import refuse_special
from hpccomponent.files.private_files import open_at_once
from hpccomponent.foreign_json import decode

Z85 = frozenset(
    "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ.-:+=^!/*?&<>()[]{}@%$#"
)
KEY_LENGTH = 40
_ADVICE = "have the file written anew"
Key = Annotated[str, Meta(pattern=rf"^[{re.escape(''.join(sorted(Z85)))}]{{{KEY_LENGTH}}}\Z")]
"""A CURVE key in Z85 text."""


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A CURVE key pair in Z85 text, 40 characters each; the secret is not in the representation."""

    public: Key
    secret: Key = field(repr=False)


def make_key_pair() -> KeyPair:
    """Make a fresh key pair."""
    public, secret = zmq.curve_keypair()
    return KeyPair(public.decode("ascii"), secret.decode("ascii"))


def is_key(text: object) -> bool:
    """Tell whether `text` has the form of a Z85 key.

    Examples
    --------
    >>> is_key(make_key_pair().public), is_key("too short")
    (True, False)
    """
    return isinstance(text, str) and len(text) == KEY_LENGTH and Z85.issuperset(text)


def write_secret(path: Path, text: str) -> None:
    """Write `text`, readable by its owner only, beside the old file and then over it as a whole.

    Raise OutputError where the file cannot be written.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text)
        os.replace(beside, path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise OutputError(
            f"{path}: the secret cannot be written ({error.strerror})",
            "choose a folder that exists and is yours",
        ) from error


def read_private_json(path: Path, version: int, keys: Collection[str]) -> dict[str, Any]:
    """Read a JSON object with exactly these keys, and trust it only if nobody else can read it.

    ``version``, which `keys` has too, must be `version`. Raise ConfigError where the file is
    missing, is readable by group or others, or is not such an object.
    """
    try:
        entries = decode(_read_private(path), dict[str, Any])
    except ValueError as error:
        raise ConfigError(f"{path}: not a JSON object ({error})", _ADVICE) from None
    if entries.get("version") != version:
        raise ConfigError(
            f"{path}: version: {entries.get('version')!r} is not {version}",
            "use the same release of hpcapp on both ends",
        )
    check_keys(f"{path}", entries, keys)
    return entries


def check_keys(where: str, entries: dict[str, Any], keys: Collection[str]) -> None:
    """Raise ConfigError, which names the file (`where`) first, for a key missing or too many."""
    for key in sorted(set(keys) ^ entries.keys()):
        verdict = "is missing" if key in keys else "is not known"
        raise ConfigError(f"{where}: {key}: {verdict}", _ADVICE)


def _read_private(path: Path) -> str:
    try:
        with open(path, encoding="utf-8", opener=open_at_once) as stream:
            file_mode = os.fstat(stream.fileno()).st_mode
            refuse_special(file_mode, path)
            mode, text = stat.S_IMODE(file_mode), stream.read()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise ConfigError(
            f"{path}: cannot be read ({reason})",
            "give the path that the loader, the master or 'hpcapp up' wrote",
        ) from error
    if mode & 0o077:
        raise ConfigError(
            f"{path}: holds a secret key, yet others may read it (mode {mode:04o})",
            f"chmod 600 {path}, and make new keys if the machine is shared",
        )
    return text
