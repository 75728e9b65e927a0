"""How large tiles are, and the room that the grid leaves: asked for before the method is loaded."""

from __future__ import annotations

__all__ = ["LARGE_TILE", "MARGIN", "TILES_EACH", "TILE_POINTS"]

MARGIN = 4
"""Cells of the grid that stay free on each side of the cloud."""

TILE_POINTS = 2_500_000
"""Of a tile where nothing else asks for smaller ones: what it takes stays below a gigabyte."""
LARGE_TILE = 1_000_000
"""Points: smaller tiles cost more for their halos than is gained by handing them out freely."""
TILES_EACH = 2
"""Of a worker, where they are as large as that; one at least. Each more costs halos, and more than
`tiles.KEPT_TILES` are prepared twice."""
