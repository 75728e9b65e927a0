"""The one door to the kernels: every hot loop of the surface, as a function of arrays.

::

    this module ──> native     C++, where the extension loads
               └──> portable   numpy: the specification, and what runs elsewhere

Both builds offer the same names with the same parameters (a test compares them), and each
function is described in full where it stands in `portable`, whose types are those of both. A
kernel's row depends on no other row of its batch and on no number of threads; the two builds agree
to rounding, and the workers of one job run the same one (see `build`).
"""

from typing import TYPE_CHECKING

from hpcapp.kernels.build import load_native
from hpcapp.kernels.constants import BASIS, COLUMNS, FINE, QUANTA, SHEETS, UNSURE, WHOLE, WRONG

if TYPE_CHECKING or load_native() is None:
    from hpcapp.kernels import portable
    from hpcapp.kernels.portable import *  # noqa: F403

    _kernels = portable.KERNELS
else:
    from hpcapp.kernels._native import *  # noqa: F403
    from hpcapp.kernels._native import __all__ as _kernels

__all__ = ["BASIS", "COLUMNS", "FINE", "QUANTA", "SHEETS", "UNSURE", "WHOLE", "WRONG"]
__all__ += _kernels
