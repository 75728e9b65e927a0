"""Clouds and hosts of machines that systemd runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from testbed.cloud import TestBed
from testbed.fixtures import hollow_wheels, mesh, wheels
from testbed.sites import Site
from testbed.systemd import SystemdMachine, missing

__all__ = ["hollow_wheels", "mesh", "wheels"]  # fixtures


@pytest.fixture
def site(wheels: Path, tmp_path: Path) -> Iterator[Site]:
    with open_bed(tmp_path) as bed:
        yield Site(bed, wheels)


@pytest.fixture
def idle_site(hollow_wheels: Path, tmp_path: Path) -> Iterator[Site]:
    """A site whose machines do no work."""
    with open_bed(tmp_path) as bed:
        yield Site(bed, hollow_wheels)


def open_bed(folder: Path) -> TestBed:
    if reason := missing():
        pytest.skip(reason)
    return TestBed(folder, machine_type=SystemdMachine)
