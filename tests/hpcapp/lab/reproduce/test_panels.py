"""Pictures side by side: every panel in its place, a label above it."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.lab.reproduce.panels import PANEL, colour_patches, draw_panels


def test_panels_stand_row_by_row_pixel_for_pixel() -> None:
    pytest.importorskip("matplotlib", reason="needs the plots extra")
    rng = np.random.default_rng(3)
    pictures = [rng.integers(0, 255, (PANEL, PANEL, 3)).astype(np.uint8) for _ in range(3)]
    drawn = draw_panels([(f"({name})", p) for name, p in zip("abc", pictures, strict=True)], 2)
    strip = drawn.shape[0] // 2 - PANEL
    assert drawn.shape == (2 * (PANEL + strip), 2 * PANEL, 3)
    for i, picture in enumerate(pictures):
        row, column = divmod(i, 2)
        top, left = row * (PANEL + strip), column * PANEL
        shown = drawn[top + strip : top + strip + PANEL, left : left + PANEL]
        assert (shown == picture).all()
        assert (drawn[top : top + strip, left : left + PANEL] < 128).any()  # the label
    assert (drawn[PANEL + strip :, PANEL:] == 255).all()  # no fourth panel


def test_patches_have_colours_of_their_own() -> None:
    colours = colour_patches(1000)
    assert len(np.unique(colours, axis=0)) > 990
