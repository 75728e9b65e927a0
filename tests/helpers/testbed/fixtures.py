"""Fixtures of the test beds: wheels for their machines, and the mesh that they must make."""

from __future__ import annotations

from pathlib import Path

import pytest

from hpcdeploy.install.wheels.requirements import WORKER_NEEDS
from testbed.sites import OPTIONS, POINTS, make_mesh, reason_to_skip
from testbed.wheels import pack_requirements_of


@pytest.fixture(scope="session")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of all wheels that machines need."""
    if reason := reason_to_skip():
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("wheels")
    pack_requirements_of("hpcapp", folder)
    return folder


@pytest.fixture(scope="session")
def hollow_wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of the wheels that a loader needs; the others are there in name only."""
    if reason := reason_to_skip():
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("hollow-wheels")
    pack_requirements_of("hpcapp", folder, WORKER_NEEDS)
    return folder


@pytest.fixture(scope="session")
def mesh(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the mesh of the small cloud, made on this machine."""
    return make_mesh(POINTS, tmp_path_factory.mktemp("mesh"), *OPTIONS)
