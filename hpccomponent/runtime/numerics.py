"""Which release this is, and the numerics id: workers of one id give the same bits."""

from __future__ import annotations

import platform
from importlib import metadata

KERNEL_GROUP = "hpc.kernels"


def numerics_id(build: str | None = None) -> str:
    """Return what decides a task's bits on this machine; HpcError where its build does not load.

    It is the ids of the installed kernels, numpy's release and the architecture, for instance
    ``native-4b1c9e0f2a77-numpy2.1.0-x86_64``, without Python's patch level; a master accepts
    workers of one id only. The build is one of the loader's catalogue, by default that of this
    process.

    Notes
    -----
    Kernels announce themselves as entry points ``hpc.kernels``: functions from the name of a
    build (or None) to an id.
    """
    entries = sorted(metadata.entry_points(group=KERNEL_GROUP), key=lambda entry: entry.name)
    kernels = "-".join(entry.load()(build) for entry in entries)
    return f"{kernels}-numpy{metadata.version('numpy')}-{platform.machine()}"


def package_version() -> str:
    """Return the installed release; master and components must be of the same."""
    return metadata.version("hpcapp")
