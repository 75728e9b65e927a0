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
