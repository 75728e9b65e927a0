"""The kernels in numpy: the specification of the native ones, and what runs without a compiler.

The kernels of a module are what its `__all__` lists. Those of `X.py` stand in `native/X.cpp`, too.
"""

from types import FunctionType
from typing import TYPE_CHECKING

from hpcapp.kernels.portable.around.leanings import *
from hpcapp.kernels.portable.around.links import *
from hpcapp.kernels.portable.around.normals import *
from hpcapp.kernels.portable.around.planes import *
from hpcapp.kernels.portable.around.sheets import *
from hpcapp.kernels.portable.around.sparse import *
from hpcapp.kernels.portable.around.supporting import *
from hpcapp.kernels.portable.around.views import *
from hpcapp.kernels.portable.field.coarse_grid import *
from hpcapp.kernels.portable.field.features import *
from hpcapp.kernels.portable.field.field import *
from hpcapp.kernels.portable.lattice.distances import *
from hpcapp.kernels.portable.lattice.folding import *
from hpcapp.kernels.portable.lattice.keys import *
from hpcapp.kernels.portable.lattice.packing import *
from hpcapp.kernels.portable.lattice.points import *
from hpcapp.kernels.portable.memory import *
from hpcapp.kernels.portable.mesh.collapse import *
from hpcapp.kernels.portable.mesh.seams import *
from hpcapp.kernels.portable.mesh.topology import *
from hpcapp.kernels.portable.quadrics.hermite import *
from hpcapp.kernels.portable.quadrics.inheritance import *
from hpcapp.kernels.portable.quadrics.moments import *
from hpcapp.kernels.portable.quadrics.robust import *
from hpcapp.kernels.portable.surface.balance import *
from hpcapp.kernels.portable.surface.bricks import *
from hpcapp.kernels.portable.surface.rims import *

KERNELS = sorted(name for name, kernel in globals().items() if isinstance(kernel, FunctionType))
if not TYPE_CHECKING:  # which takes what is imported here as it stands
    __all__ = KERNELS
