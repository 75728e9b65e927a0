"""Scans of real objects: in the folder that HPCAPP_DATA names, else in ../shared/data of the clone.

They are too large for the repository. Where they are not at hand their tests are skipped; in CI
they must be.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

FOLDER = Path(os.environ.get("HPCAPP_DATA") or Path(__file__).parents[3] / "shared/data").absolute()


def shared(name: str) -> Path:
    """Return a file or folder of theirs, or leave the test that needs it."""
    path = FOLDER / name
    if path.exists():
        return path
    lack = f"{path} is not there: let HPCAPP_DATA name the folder of the real scans"
    if os.environ.get("CI") == "true":
        pytest.fail(lack, pytrace=False)
    pytest.skip(lack)
