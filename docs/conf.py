"""The site: Sphinx with MyST and furo; ``sphinx-build -W docs site``."""

from __future__ import annotations

import sys
from importlib import metadata
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent))

import equations
import reference_pages

project = "hpcapp"
release = metadata.version("hpcapp")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["README.md"]
myst_heading_anchors = 4
myst_enable_extensions = ["deflist", "dollarmath"]
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
html_math_renderer = "mathml"
html_theme = "furo"
html_title = "hpcapp"
smartquotes = False  # options and commands stand in running text
html_static_path = ["_static"]
html_css_files = ["front.css"]


def setup(app: Sphinx) -> None:
    """Draw equations; write the generated pages before any page is read."""
    equations.add_renderer(app)
    app.connect("builder-inited", lambda _: reference_pages.write(Path(__file__).parent))
