"""Which release this is, and the numerics id: workers of one id give the same bits."""

from __future__ import annotations

import os
from importlib import metadata

KERNEL_GROUP = "hpc.kernels"


def numerics_id(build: str | None = None) -> str:
    """Return what decides a task's bits on this machine.

    Parameters
    ----------
    build : str, optional
        Name of the worker build in the loader's catalogue; by default what this process runs.

    Returns
    -------
    str
        The ids of the installed kernels, numpy's release and the architecture, for instance
        ``native-4b1c9e0f2a77-numpy2.1.0-x86_64``; a master accepts workers of one id only. The
        Python patch level has no part in it.

    Raises
    ------
    HpcError
        The build does not load on this machine.

    Notes
    -----
    Kernels announce themselves as entry points ``hpc.kernels``: functions from the name of a
    build (or None) to an id.
    """
    entries = sorted(metadata.entry_points(group=KERNEL_GROUP), key=lambda entry: entry.name)
    kernels = "-".join(entry.load()(build) for entry in entries)
    return f"{kernels}-numpy{metadata.version('numpy')}-{os.uname().machine}"


def package_version() -> str:
    """Return the installed release; master and components must be of the same."""
    return metadata.version("hpcapp")
