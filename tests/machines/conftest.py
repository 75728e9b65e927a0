"""Everything that the wheels of hpcapp require, packed once from what is installed here."""

from __future__ import annotations

from pathlib import Path

import pytest
from testbed.wheels import pack_requirements_of


@pytest.fixture(scope="session")
def wheelhouse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheelhouse")
    pack_requirements_of("hpcapp", folder)
    return folder
