"""CURVE key pairs: one for the master, one for every worker; secrets live in files of mode 0600."""

from __future__ import annotations

import os
import re
from dataclasses import field
from pathlib import Path
from typing import Annotated

import zmq
from msgspec import Meta

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import OutputError

Z85 = frozenset(
    "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ.-:+=^!/*?&<>()[]{}@%$#"
)
KEY_LENGTH = 40
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
