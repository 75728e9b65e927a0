"""What the tests of all figures share."""

from __future__ import annotations

from importlib.util import find_spec
from io import BytesIO

import pytest


@pytest.fixture(autouse=True, scope="session")
def _fonts() -> None:
    """Draw outside the tests once: matplotlib keeps its fonts open, which is no leak of ours."""
    if find_spec("matplotlib") is not None:
        from matplotlib.figure import Figure

        figure = Figure()
        title = "24\N{SUPERSCRIPT THREE} $x \\times \\mathdefault{10^{0}}$"
        figure.subplots().set(yscale="log", ylim=(0.1, 10.0), title=title)
        figure.savefig(BytesIO(), format="png")
