"""JSON files that hold secrets: read only where nobody else can, and only whole."""

from __future__ import annotations

import os
import stat
from collections.abc import Collection
from pathlib import Path
from typing import Any

from hpccomponent.errors import ConfigError
from hpccomponent.files.paths import refuse_special
from hpccomponent.files.private_files import open_at_once
from hpccomponent.foreign_json import decode

ADVICE = "have the file written anew"


def read_private_json(path: Path, version: int, keys: Collection[str]) -> dict[str, Any]:
    """Read a JSON object with exactly these keys, and trust it only if nobody else can read it.

    ``version``, which `keys` has too, must be `version`. Raise ConfigError where the file is
    missing, is readable by group or others, or is not such an object.
    """
    try:
        entries = decode(_read_private(path), dict[str, Any])
    except ValueError as error:
        raise ConfigError(f"{path}: not a JSON object ({error})", ADVICE) from None
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
        raise ConfigError(f"{where}: {key}: {verdict}", ADVICE)


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
