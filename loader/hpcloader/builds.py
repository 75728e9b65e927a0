"""The catalogue of worker builds, and the choice of the first one that fits a machine."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator

from hpccomponent.config import ConfigModel, read_config
from hpccomponent.errors import ConfigError
from hpcloader.machine import Machine

__all__ = [
    "BUILD_VARIABLE",
    "TASK_PATTERN",
    "Build",
    "Catalogue",
    "Choice",
    "Requirements",
    "choose_build",
    "parse_size",
    "read_catalogue",
]

BUILD_VARIABLE = "HPCAPP_BUILD"
"""The environment variable that names the build of a job's master, and so of its workers."""

TASK_PATTERN = r"^[\w.-]+=[\w.]+:\w+$"  # NAME=module:function

_UNITS = {"": 1, "B": 1, "KIB": 2**10, "MIB": 2**20, "GIB": 2**30, "TIB": 2**40}


def parse_size(size: int | str) -> int:
    """Return a size in bytes.

    Parameters
    ----------
    size : int or str
        Bytes, or text such as ``512 MiB``.

    Raises
    ------
    ValueError
        The text is no size.

    Examples
    --------
    >>> parse_size("1.5 GiB")
    1610612736
    """
    if isinstance(size, int) and not isinstance(size, bool):
        return size
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([A-Za-z]*)", str(size).strip())
    if match is None or match[2].upper() not in _UNITS:
        raise ValueError("should be a size such as 512 MiB or 2 GiB")
    return int(float(match[1]) * _UNITS[match[2].upper()])


class Requirements(ConfigModel):
    """What a build asks of a machine; what is left out is not asked.

    Parameters
    ----------
    architecture : tuple of str
        One of these.
    cpu_flags : tuple of str
        All of these.
    min_cores : int
        So many cores.
    min_memory : int
        So many bytes.
    gpu : str, optional
        Part of a GPU's name, or ``any``.
    module : str, optional
        A module that this interpreter can find.
    """

    architecture: tuple[str, ...] = ()
    cpu_flags: tuple[str, ...] = ()
    min_cores: int = Field(default=1, ge=1)
    min_memory: Annotated[int, BeforeValidator(parse_size), Field(ge=0)] = 0
    gpu: str | None = None
    module: str | None = Field(default=None, pattern=r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)*$")

    def unmet(self, machine: Machine) -> Iterator[str]:
        """Yield, in words, each thing that `machine` lacks."""
        if self.architecture and machine.architecture not in self.architecture:
            yield f"architecture is {machine.architecture}, not {' or '.join(self.architecture)}"
        missing = [flag for flag in self.cpu_flags if flag not in machine.cpu_flags]
        if missing:
            yield f"the processor lacks {', '.join(missing)}"
        if machine.cores < self.min_cores:
            yield f"cores: {machine.cores}, needed {self.min_cores}"
        if machine.memory < self.min_memory:
            yield f"memory: {machine.memory / 2**30:.1f} GiB, needed {self.min_memory / 2**30:.1f}"
        if self.gpu is not None and not _has_gpu(machine, self.gpu):
            yield (
                f"no GPU {self.gpu!r} among {', '.join(machine.gpus)}" if machine.gpus else "no GPU"
            )
        if self.module is not None and not _can_find(self.module):
            yield f"module {self.module} is not installed"


class Build(ConfigModel):
    """One way to run a worker.

    Parameters
    ----------
    name : str
        What the component announces to the communicator.
    requires : Requirements
        What it asks of a machine.
    command : tuple of str
        The component's command line, without what the loader adds; ``{python}`` stands for
        the loader's own interpreter.
    tasks : tuple of str
        ``NAME=module:function`` of tasks that this build brings along.
    """

    name: str = Field(pattern=r"^[\w.-]+$")
    requires: Requirements = Requirements()
    command: tuple[str, ...] = Field(min_length=1)
    tasks: tuple[Annotated[str, Field(pattern=TASK_PATTERN)], ...] = ()

    @field_validator("command")
    @classmethod
    def _known_placeholders(cls, command: tuple[str, ...]) -> tuple[str, ...]:
        unknown = set(re.findall(r"\{[^{}]*\}", " ".join(command))) - {"{python}"}
        if unknown:
            raise ValueError(f"only {{python}} is filled in, not {', '.join(sorted(unknown))}")
        return command

    def argv(self) -> list[str]:
        """Return the command line with its placeholders filled in."""
        return [part.replace("{python}", sys.executable) for part in self.command]


class Catalogue(ConfigModel):
    """All worker builds, best first."""

    version: Literal[1]
    builds: tuple[Build, ...] = Field(min_length=1)

    @field_validator("builds")
    @classmethod
    def _distinct_names(cls, builds: tuple[Build, ...]) -> tuple[Build, ...]:
        names = [build.name for build in builds]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two builds are called {', '.join(twice)}")
        return builds


@dataclass(frozen=True, slots=True)
class Choice:
    """The build that fits, and why each better one does not.

    Parameters
    ----------
    build : Build
        The first that fits.
    passed_over : tuple of (str, str)
        Name and reason of each build before it.
    """

    build: Build
    passed_over: tuple[tuple[str, str], ...]


def read_catalogue(path: Path | None = None) -> Catalogue:
    """Read a catalogue, by default the one that comes with the loader.

    Raises
    ------
    ConfigError
        The file is not as it should be.
    """
    return read_config(path or Path(__file__).with_name("builds.yaml"), Catalogue)


def choose_build(catalogue: Catalogue, machine: Machine, wanted: str = "") -> Choice:
    """Choose the first build whose requirements `machine` meets.

    Parameters
    ----------
    catalogue : Catalogue
    machine : Machine
    wanted : str
        Name of the only build to consider; by default all are.

    Returns
    -------
    Choice

    Raises
    ------
    ConfigError
        None fits; the message gives each one's reason.
    """
    passed_over: list[tuple[str, str]] = []
    for build in catalogue.builds:
        unmet = list(build.requires.unmet(machine))
        if wanted not in ("", build.name):
            unmet.append(f"{BUILD_VARIABLE} asks for {wanted}")
        if not unmet:
            return Choice(build, tuple(passed_over))
        passed_over.append((build.name, ", ".join(unmet)))
    reasons = "; ".join(f"{name} ({reason})" for name, reason in passed_over)
    raise ConfigError(
        f"no worker build of the catalogue fits this machine: {reasons}",
        "add a build that asks for less, such as the portable one",
    )


def _has_gpu(machine: Machine, wanted: str) -> bool:
    return any(wanted == "any" or wanted.lower() in gpu.lower() for gpu in machine.gpus)


def _can_find(module: str) -> bool:
    """Tell whether a module is installed, without running it; the packages above it are run."""
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):  # no such package above it, or one that is half loaded
        return False
