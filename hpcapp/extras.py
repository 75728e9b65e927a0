"""Libraries that only some of the formats, options and engines need: the extras of the package."""

from __future__ import annotations

import shlex
import sys


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
