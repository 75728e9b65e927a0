"""Types of what fixtures give, for the tests that ask for them."""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.kernels.types.grid import Grid

StartComponent = Callable[..., "subprocess.Popen[str]"]
StartCommand = Callable[..., "subprocess.Popen[str]"]

Function = Callable[[FloatArray], FloatArray]
BrickFunction = Callable[[IntArray], NDArray[np.float32]]
BrickValues = Callable[[Function, Grid], BrickFunction]
