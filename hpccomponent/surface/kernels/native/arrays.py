"""The extension, and its arrays: contiguous, and of the type that it takes."""

from __future__ import annotations

from typing import Any

import numpy as np

from hpccomponent.surface.build import load_native
from hpccomponent.surface.types.points import Float32Array, FloatArray, IntArray

__all__ = ["floats", "integers", "native", "singles"]

native: Any = load_native()  # None where it does not load: then nobody calls what uses it


def floats(values: Any) -> FloatArray:
    """Return an array, or what becomes one, as doubles."""
    return np.ascontiguousarray(values, np.float64)


def singles(values: Any) -> Float32Array:
    """Return an array, or what becomes one, as single-precision numbers."""
    return np.ascontiguousarray(values, np.float32)


def integers(values: Any) -> IntArray:
    """Return an array, or what becomes one, as 64-bit integers."""
    return np.ascontiguousarray(values, np.int64)
