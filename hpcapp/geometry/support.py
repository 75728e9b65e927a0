"""How far the vertices of a mesh are from the points that it was made of, as files carry it."""

from __future__ import annotations

SUPPORT = "support"
"""The attribute of vertices: their distance from the nearest point, in spacings there."""
GUESSED = 6.0
"""Of it: beyond, the surface is guesswork."""
