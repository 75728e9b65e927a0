"""The whole way, by the verbs that users type, on machines that really boot."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from testbed.cloud import TestBed
from testbed.wheels import pack_requirements_of

from hpcdeploy.requirements import WORKER_NEEDS
from tier_b.sites import OPTIONS, POINTS, MakeSite, Site, make_mesh, reason_to_skip


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


@pytest.fixture
def make_site(wheels: Path, tmp_path: Path) -> Iterator[MakeSite]:
    """Make the one test bed of a test."""
    beds: list[TestBed] = []

    def make(profile: str = "aws") -> Site:
        beds.append(TestBed(tmp_path, profile))
        return Site(beds[0], wheels)

    yield make
    for bed in beds:
        bed.__exit__(None, None, None)


@pytest.fixture
def site(make_site: MakeSite) -> Site:
    return make_site()


@pytest.fixture
def idle_site(hollow_wheels: Path, tmp_path: Path) -> Iterator[Site]:
    """A site whose machines do no work."""
    with TestBed(tmp_path) as bed:
        yield Site(bed, hollow_wheels)


@pytest.fixture(scope="session")
def mesh(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the mesh of the small cloud, made on this machine."""
    return make_mesh(POINTS, tmp_path_factory.mktemp("mesh"), *OPTIONS)
