"""Where things lie: on a machine, below the login user's home, and on the user's own machine.

::

    on every machine: hpcapp/CLUSTER/     on the user's machine: STATE/CLUSTER/
      venv/          the installed package      journal.jsonl   the intents
      wheels/        what it came from          id              the SSH key, 0600
      loader.yaml    0600                       known_hosts     the pinned host keys
      connection.json  keys, 0600               keys.json       CURVE keys of all nodes, 0600
      loader.log, loader.pid, watch-loader
      installed, configured   stamps: what is there already
      inventory.json   head only, 0600
      jobs/JOB/        head only

STATE is ``$XDG_STATE_HOME/hpcapp/clusters``, by default below ``~/.local/state``.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from hpccomponent.files.paths import home_folder

_OURS = (
    "id",
    "id.before",
    ".id.*",  # of a maker that was killed
    "known_hosts",
    "known_hosts.*",
    "keys.json",
    "keys.json.*",
    "release/*",
    "journal.jsonl",
)


def machine_folder(cluster: str) -> str:
    """Return the folder of a cluster on a machine, relative to the login user's home."""
    return f"hpcapp/{cluster}"


def clusters_folder() -> Path:
    """Return the folder of all clusters on the user's own machine; it need not exist.

    Raises UsageError where the user has no home.
    """
    named = os.environ.get("XDG_STATE_HOME", "")
    if not Path(named).is_absolute():  # to be ignored then, says whoever defined it
        named = f"{home_folder()}/.local/state"
    return Path(named) / "hpcapp/clusters"


def state_folder(cluster: str) -> Path:
    """Return the folder of a cluster on the user's own machine; it need not exist."""
    return clusters_folder() / cluster


def forget_cluster(cluster: str) -> None:
    """Remove what this machine knows of a cluster that is gone; what is not ours stays there."""
    folder = state_folder(cluster)
    for pattern in _OURS:
        for path in folder.glob(pattern):
            path.unlink(missing_ok=True)
    top = clusters_folder()
    for empty in (folder / "nodes", folder / "release", folder, top, top.parent):
        with suppress(OSError):
            empty.rmdir()
