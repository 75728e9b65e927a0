"""The whole way, by the verbs that users type, on machines that really boot."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from testbed.cloud import TestBed
from testbed.fixtures import hollow_wheels, mesh, wheels
from testbed.sites import MakeSite, Site

__all__ = ["hollow_wheels", "mesh", "wheels"]  # fixtures


@pytest.fixture
def make_site(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[MakeSite]:
    """Make the one test bed of a test; the machines of an idle one do no work."""
    beds: list[TestBed] = []

    def make(profile: str = "aws", idle: bool = False) -> Site:
        beds.append(TestBed(tmp_path, profile))
        return Site(beds[0], request.getfixturevalue("hollow_wheels" if idle else "wheels"))

    yield make
    for bed in beds:
        bed.__exit__()


@pytest.fixture
def site(make_site: MakeSite) -> Site:
    return make_site()


@pytest.fixture
def idle_site(make_site: MakeSite) -> Site:
    return make_site(idle=True)
