"""Libraries that only some of the formats, options and engines need: the extras of the package."""

from __future__ import annotations

import shlex
import sys
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from hpccomponent.errors import MissingLibraryError


def how_to_install(extra: str) -> str:
    """Return the command that installs the libraries of an extra.

    Names the libraries and this very Python: that holds however hpcapp itself was installed, from
    a clone, a wheel or by pipx, and asks no registry for hpcapp.

    Examples
    --------
    >>> how_to_install("e57").partition(" -m ")[2]
    "pip install 'pye57>=0.4.13'"
    """
    from importlib.metadata import requires  # an error's way: no job pays for it

    from packaging.requirements import Requirement

    stated = map(Requirement, requires("hpcapp") or ())
    libraries = []
    for one in stated:
        if one.marker is not None and one.marker.evaluate({"extra": extra}):
            one.marker = None
            libraries.append(str(one))
    return shlex.join([sys.executable, "-m", "pip", "install", *libraries])


def load_library(module: str, problem: str, extra: str) -> Any:
    """Import a library of an extra; MissingLibraryError states the problem where it is missing."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingLibraryError(problem, how_to_install(extra)) from error


def require_library(module: str, problem: str, extra: str) -> None:
    """Find out before the work whether `load_library` would find a library, without loading it."""
    if find_spec(module) is None:
        raise MissingLibraryError(problem, how_to_install(extra))
