"""Numbers that both builds of the kernels, and those who call them, go by."""

from __future__ import annotations

BASIS = 10
"""Coefficients of a quadric."""

MONOMIALS = 35
"""Of three coordinates, of degree 4 and less."""

COLUMNS = MONOMIALS + 9
"""Of the moments: the monomials, and what normals add to them."""

QUANTA = 1 << 23
"""Along a block of arranged points: their middles fit into the significand of float32."""

SHEETS = 12
"""Groups of a cell's points that lie on one sheet each, at most: what is left then is the last."""

FINE, UNSURE, WRONG = 0, 1, 2
"""What `poll_normals` finds of a normal."""

WHOLE = 127
"""What `view_patches` makes of a cosine of one: the largest number of a byte."""
