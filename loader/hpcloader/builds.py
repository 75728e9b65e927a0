"""The worker builds, and the choice of the first one that fits a machine.

What people write of them is read by `hpcloader.files`. Nothing here needs it: a loader without
such a file starts in less than half the time.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from importlib.util import find_spec

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ConfigError
from hpcloader.machine import Machine

BUILD_VARIABLE = "HPCAPP_BUILD"
"""The environment variable that names the build of a job's master, and so of its workers."""


@dataclass(frozen=True, slots=True)
class Requirements:
    """What a build asks of a machine; what is left out is not asked.

    The architecture is one of these, as ``uname -m`` names them; the flags are all there, as in
    ``/proc/cpuinfo``. `min_memory` is in bytes; `gpu` is part of a GPU's name, or ``any``; `module`
    is one that this interpreter can find.
    """

    architecture: tuple[str, ...] = ()
    cpu_flags: tuple[str, ...] = ()
    min_cores: int = 1
    min_memory: int = 0
    gpu: str | None = None
    module: str | None = None

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
        wanted = "" if self.gpu == "any" else (self.gpu or "").lower()
        if self.gpu is not None and not any(wanted in gpu.lower() for gpu in machine.gpus):
            yield (
                f"no GPU {self.gpu!r} among {', '.join(machine.gpus)}" if machine.gpus else "no GPU"
            )
        if self.module is not None and not _can_find(self.module):
            yield f"module {self.module} is not installed"


@dataclass(frozen=True, slots=True)
class Build:
    """One way to run a worker; the component announces its name to the communicator.

    `command` is the component's command line, without what the loader adds; ``{python}`` stands for
    the loader's own interpreter. `tasks`, ``NAME=module:function``, are what this build brings
    along.
    """

    name: str
    command: tuple[str, ...]
    requires: Requirements = Requirements()
    tasks: tuple[str, ...] = ()

    def argv(self) -> list[str]:
        """Return the command line with its placeholders filled in."""
        return [part.replace("{python}", sys.executable) for part in self.command]


_COMPONENT = ("{python}", "-P", "-m", "hpccomponent")

BUILDS: tuple[Build, ...] = (
    Build("native", _COMPONENT, Requirements(module="hpcapp.kernels._native")),
    Build("portable", _COMPONENT),
)
"""The builds that come with the loader, best first."""


@dataclass(frozen=True, slots=True)
class BuildChoice:
    """The first build that fits, and the name and reason of each build before it."""

    build: Build
    passed_over: tuple[tuple[str, str], ...]


def choose_build(builds: Sequence[Build], machine: Machine, wanted: str = "") -> BuildChoice:
    """Choose the first build, of those listed best first, whose requirements `machine` meets.

    With `wanted` only the build of that name is considered. Raise ConfigError, which gives each
    one's reason, where none fits.
    """
    passed_over: list[tuple[str, str]] = []
    for build in builds:
        unmet = list(build.requires.unmet(machine))
        if wanted not in ("", build.name):
            unmet.append(f"{BUILD_VARIABLE} asks for {wanted}")
        if not unmet:
            return BuildChoice(build, tuple(passed_over))
        passed_over.append((build.name, ", ".join(unmet)))
    reasons = "; ".join(f"{name} ({reason})" for name, reason in passed_over)
    raise ConfigError(
        f"no worker build of the catalogue fits this machine: {reasons}",
        "add a build that asks for less, such as the portable one",
    )


def _can_find(module: str) -> bool:
    """Tell whether a module is installed, without running it; the packages above it are run."""
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):  # no such package above it, or one that is half loaded
        return False
