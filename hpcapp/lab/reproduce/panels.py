"""Pictures side by side, each below its label, by matplotlib; the colours of patches."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.extras import require_library

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Picture = NDArray[np.uint8]

#: Width and height of a panel, in pixels.
PANEL = 480
_LABEL = 48  # pixels above each panel
_DPI = 100
_GOLDEN = 0.618033988749895  # turns of hue between neighbours of the tree: all of them differ


def check_plots() -> None:
    """Refuse a figure before it is measured, where matplotlib is not installed."""
    problem = "figures are drawn by matplotlib, which is not installed"
    require_library("matplotlib", problem, "plots")


def draw_panels(panels: Sequence[tuple[str, Picture]], columns: int) -> Picture:
    """Return pictures, at least one, row by row in so many columns, each with its label above it.

    Each is of (PANEL, PANEL, 3).
    """
    from matplotlib.figure import Figure  # optional and heavy

    rows = -(-len(panels) // columns)
    width, height = columns * PANEL, rows * (PANEL + _LABEL)
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
    for i, (label, picture) in enumerate(panels):
        row, column = divmod(i, columns)
        bottom = height - (row + 1) * (PANEL + _LABEL)  # of the panel, from the figure's
        figure.figimage(picture[::-1], column * PANEL, bottom, origin="lower")
        x, y = (column + 0.5) * PANEL, bottom + PANEL + 0.5 * _LABEL
        figure.text(x / width, y / height, label, ha="center", va="center", fontsize=17)
    return _rasterise(figure)


def colour_patches(count: int) -> NDArray[np.uint8]:
    """Return a colour for each patch, shape (count, 3); neighbours of the tree differ."""
    palette = [
        colorsys.hsv_to_rgb(i * _GOLDEN % 1.0, (0.85, 0.55, 0.7)[i % 3], (0.95, 1.0, 0.7)[i % 3])
        for i in range(count)
    ]
    return (255.0 * np.array(palette) + 0.5).astype(np.uint8)


def _rasterise(figure: Figure) -> Picture:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)  # typed in parts
    canvas.draw()
    return np.asarray(canvas.buffer_rgba(), np.uint8)[..., :3].copy()
