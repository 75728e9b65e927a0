"""Which build of the kernels runs: the C++ extension where it loads, else plain numpy.

The environment variable ``HPCAPP_BUILD`` chooses: ``portable`` for numpy, ``native`` to insist on
the extension. Nothing heavy is imported here.
"""

from __future__ import annotations

import os
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

from hpccomponent.errors import UsageError

BUILD_VARIABLE = "HPCAPP_BUILD"

_EXTENSION = "hpcapp.kernels._native"


@cache
def _import_extension() -> ModuleType | str:
    """Return the extension, or in words why it does not load."""
    try:
        return import_module(_EXTENSION)
    except ImportError as error:
        return str(error)


def load_native(build: str | None = None) -> ModuleType | None:
    """Return the C++ extension, None where the portable build is to run.

    `build` is ``portable``, or ``native`` to insist on the extension; any other name takes what
    loads. By default it is what ``HPCAPP_BUILD`` says. Raise `UsageError` where the build is
    ``native``, and the extension does not load.
    """
    wanted = os.environ.get(BUILD_VARIABLE, "") if build is None else build
    if wanted == "portable":
        return None
    extension = _import_extension()
    if isinstance(extension, ModuleType):
        return extension
    if wanted == "native":
        raise UsageError(
            f"the native kernels are asked for and do not load ({extension})",
            f"install hpcapp where a C++ compiler is found, or set {BUILD_VARIABLE}=portable",
        )
    return None


def kernel_id(build: str | None = None) -> str:
    """Return what decides the bits of the kernels: the build, and a hash of their code.

    For instance ``native-4b1c9e0f2a77``. `build` and what is raised are as for `load_native`.
    """
    extension = load_native(build)
    if extension is not None:
        return f"native-{extension.KERNEL_HASH}"
    from hpcapp.kernels.digest import (
        digest_code,  # it loads OpenSSL: `--version` would feel it
    )

    return f"portable-{digest_code(Path(__file__).parents[1])}"
