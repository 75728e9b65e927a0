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

    Parameters
    ----------
    name : str
        Of this machine, for the logs.
    connection : Path
        The connection file that the component reads.
    tasks : tuple of str
        ``NAME=module:function``, passed on to the component.
    restart : RestartRule
        How a component that has ended is started again.
    builds : tuple of Build
        The catalogue of worker builds, best first.
    """

    name: str
    connection: Path
    tasks: tuple[str, ...] = ()
    restart: RestartRule = _RULE
    builds: tuple[Build, ...] = BUILDS
