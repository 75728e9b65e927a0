"""Which release this is, and the numerics id: workers of one id give the same bits."""

from __future__ import annotations

import platform
from importlib import metadata

__all__ = ["numerics_id", "package_version"]


def numerics_id(build: str = "portable") -> str:
    """Return what decides a task's bits on this machine.

    Parameters
    ----------
    build : str
        Name of the worker build in the loader's catalogue.

    Returns
    -------
    str
        Build, numpy release and architecture; a master accepts workers of one id only. The
        Python patch level has no part in it.
    """
    return f"{build}-numpy{metadata.version('numpy')}-{platform.machine()}"


def package_version() -> str:
    """Return the installed release; master and components must be of the same."""
    return metadata.version("hpcapp")
