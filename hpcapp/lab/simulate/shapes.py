"""The catalogue of analytic models with known truth.

Every shape in `SHAPES` is one closed surface. Sizes and positions differ on purpose: nothing
that reads points may assume a unit box.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from hpcapp.lab.simulate.catalogue.classic import CLASSIC
from hpcapp.lab.simulate.catalogue.parts import PARTS
from hpcapp.lab.simulate.catalogue.sculptures import SCULPTURES
from hpcapp.lab.simulate.implicit import Solid
from hpccomponent.errors import UsageError

SHAPES: Mapping[str, Solid] = MappingProxyType(
    {shape.name: shape for shape in (*CLASSIC, *PARTS, *SCULPTURES)}
)


def find_shape(name: str) -> Solid:
    """Return the shape of that name; `UsageError`, which names all, where there is none.

    Examples
    --------
    >>> find_shape("torus").genus
    1
    """
    if name not in SHAPES:
        known = ", ".join(SHAPES)
        raise UsageError(f"there is no shape named {name!r}", f"choose one of {known}")
    return SHAPES[name]
