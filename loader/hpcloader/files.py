"""The files that people write for a loader: ``loader.yaml``, and a catalogue of worker builds.

::

    file ──> model, strict: every mistake with its line ──> `LoaderSettings`, `Build`

Imported where there is such a file only: to describe and read one takes longer than all else that
a loader does before it starts its component.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator

from hpccomponent.config.reader import ConfigModel, read_config
from hpccomponent.errors import ConfigError
from hpccomponent.files.paths import expand_home
from hpccomponent.units import parse_size
from hpcloader.builds import BUILDS, Build, Requirements
from hpcloader.settings import LoaderSettings
from hpcloader.supervisor import RestartRule

_RULE, _ASKED = RestartRule(), Requirements()


def read_settings(path: Path) -> LoaderSettings:
    """Read ``loader.yaml``; its paths, relative to it, come back absolute.

    Raise ConfigError where it is not as it should be, or the connection file is not there.
    """
    file = read_config(path, _LoaderFile)
    folder = path.absolute().parent
    connection = folder / expand_home(file.connection)
    if not connection.is_file():
        raise ConfigError(
            f"{path}: connection: no file {connection}",
            "the master or the deployment writes it; give its path",
        )
    builds = read_catalogue(folder / expand_home(file.catalogue)) if file.catalogue else BUILDS
    return LoaderSettings(file.name, connection, file.tasks, file.restart.rule(), builds)


def read_catalogue(path: Path) -> tuple[Build, ...]:
    """Read a catalogue of worker builds; ConfigError where it is not as it should be."""
    return tuple(block.build() for block in read_config(path, _CatalogueFile).builds)


_Task = Annotated[str, Field(pattern=r"^[\w.-]+=[\w.]+:\w+$")]  # NAME=module:function


class _RestartBlock(ConfigModel):
    """How a component that has ended is started again: see `RestartRule`."""

    first_s: float = Field(default=_RULE.first_s, ge=0.01, le=86400)
    cap_s: float = Field(default=_RULE.cap_s, ge=0.01, le=86400)
    give_up_after: int = Field(default=_RULE.give_up_after, ge=1)

    def rule(self) -> RestartRule:
        return RestartRule(self.first_s, max(self.first_s, self.cap_s), self.give_up_after)


class _LoaderFile(ConfigModel):
    """What ``loader.yaml`` says: see `LoaderSettings`."""

    version: Literal[1]
    name: str = Field(pattern=r"^[\w.-]+$")
    connection: Path
    catalogue: Path | None = None
    tasks: tuple[_Task, ...] = ()
    restart: _RestartBlock = _RestartBlock()


class _RequirementsBlock(ConfigModel):
    """What a build asks of a machine: see `Requirements`."""

    architecture: tuple[str, ...] = _ASKED.architecture
    cpu_flags: tuple[str, ...] = _ASKED.cpu_flags
    min_cores: int = Field(default=_ASKED.min_cores, ge=1)
    min_memory: Annotated[int, BeforeValidator(parse_size), Field(ge=0)] = _ASKED.min_memory
    gpu: str | None = _ASKED.gpu
    module: str | None = Field(default=_ASKED.module, pattern=r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)*$")


class _BuildBlock(ConfigModel):
    """One way to run a worker: see `Build`."""

    name: str = Field(pattern=r"^[\w.-]+$")
    requires: _RequirementsBlock = _RequirementsBlock()
    command: tuple[str, ...] = Field(min_length=1)
    tasks: tuple[_Task, ...] = ()

    @field_validator("command")
    @classmethod
    def _known_placeholders(cls, command: tuple[str, ...]) -> tuple[str, ...]:
        unknown = set(re.findall(r"\{[^{}]*\}", " ".join(command))) - {"{python}"}
        if unknown:
            raise ValueError(f"only {{python}} is filled in, not {', '.join(sorted(unknown))}")
        return command

    def build(self) -> Build:
        return Build(self.name, self.command, Requirements(**dict(self.requires)), self.tasks)


class _CatalogueFile(ConfigModel):
    """All worker builds, best first."""

    version: Literal[1]
    builds: tuple[_BuildBlock, ...] = Field(min_length=1)

    @field_validator("builds")
    @classmethod
    def _distinct_names(cls, builds: tuple[_BuildBlock, ...]) -> tuple[_BuildBlock, ...]:
        names = [build.name for build in builds]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two builds are called {', '.join(twice)}")
        return builds
