"""The loader's own file, ``loader.yaml``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from hpccomponent.config import ConfigModel, read_config
from hpccomponent.errors import ConfigError
from hpcloader.builds import TASK_PATTERN
from hpcloader.supervisor import RestartRule

__all__ = ["LoaderSettings", "Restart", "read_settings"]

_DEFAULT = RestartRule()


class Restart(ConfigModel):
    """How a component that has ended is started again.

    Parameters
    ----------
    first_s, cap_s : float
        The first delay, and the longest, in seconds; each quick end in a row doubles it.
    give_up_after : int
        After so many quick failures in a row the loader leaves.
    """

    first_s: float = Field(default=_DEFAULT.first_s, ge=0.01, le=86400)
    cap_s: float = Field(default=_DEFAULT.cap_s, ge=0.01, le=86400)
    give_up_after: int = Field(default=_DEFAULT.give_up_after, ge=1)

    def rule(self) -> RestartRule:
        """Return the rule for the supervisor."""
        return RestartRule(self.first_s, max(self.first_s, self.cap_s), self.give_up_after)


class LoaderSettings(ConfigModel):
    """What ``loader.yaml`` says.

    Parameters
    ----------
    version : 1
        Of the file's format.
    name : str
        Of this machine, for the logs.
    connection : Path
        The connection file that the component reads; relative to ``loader.yaml``.
    catalogue : Path, optional
        Of worker builds, relative to ``loader.yaml``; by default the loader's own.
    tasks : tuple of str
        ``NAME=module:function``, passed on to the component.
    restart : Restart
        How a component that has ended is started again.
    """

    version: Literal[1]
    name: str = Field(pattern=r"^[\w.-]+$")
    connection: Path
    catalogue: Path | None = None
    tasks: tuple[Annotated[str, Field(pattern=TASK_PATTERN)], ...] = ()
    restart: Restart = Restart()


def read_settings(path: Path) -> LoaderSettings:
    """Read ``loader.yaml``; its paths come back absolute.

    Raises
    ------
    ConfigError
        The file is not as it should be, or the connection file is not there.
    """
    settings = read_config(path, LoaderSettings)
    folder = path.absolute().parent
    connection = folder / settings.connection.expanduser()
    if not connection.is_file():
        raise ConfigError(
            f"{path}: connection: no file {connection}",
            "the master or the deployment writes it; give its path",
        )
    catalogue = folder / settings.catalogue.expanduser() if settings.catalogue else None
    return settings.model_copy(update={"connection": connection, "catalogue": catalogue})
