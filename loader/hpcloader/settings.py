"""What a loader is told, by its file or on its command line."""

from __future__ import annotations

from pathlib import Path

from hpccomponent.dataclass import dataclass
from hpcloader.builds import BUILDS, Build
from hpcloader.supervisor import RestartRule

_RULE = RestartRule()


@dataclass(frozen=True, slots=True)
class LoaderSettings:
    """What a loader is told.

    The name is that of this machine, for the logs. The component reads the connection file, and
    gets the tasks, ``NAME=module:function``. The builds are the catalogue, best first.
    """

    name: str
    connection: Path
    tasks: tuple[str, ...] = ()
    restart: RestartRule = _RULE
    builds: tuple[Build, ...] = BUILDS
