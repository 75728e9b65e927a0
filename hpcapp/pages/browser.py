"""Shows a page in a browser."""

from __future__ import annotations

import logging
import webbrowser
from pathlib import Path

log = logging.getLogger("hpcapp")


def show_page(path: Path, *, is_opened: bool) -> Path:
    """Open a page in a browser, if one is wanted at all."""
    if is_opened and not webbrowser.open(path.resolve().as_uri()):
        log.warning("warning: no browser was found: open %s by hand", path)
    return path
