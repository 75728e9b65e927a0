"""Jobs whose points do not fit into memory, however few they are."""

from __future__ import annotations

import pytest

from hpcapp.applications.surface.cli import run
from hpcapp.applications.surface.job import plan, site


def leave_little_memory(patch: pytest.MonkeyPatch, tile: int | None = None) -> None:
    """Let any points be too many for memory, and a tile have so many at most."""
    patch.setattr(plan, "fits_memory", lambda *_: False)
    if tile is not None:
        patch.setattr(run, "TILE_POINTS", tile)
        patch.setattr(site, "choose_tile", lambda *_: tile)
