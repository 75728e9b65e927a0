"""What decides about the ground has a margin."""

from __future__ import annotations

import pytest
from ground import measure_mesh, measure_points, scan

from hpcapp.parts import ground


def test_wrong_returns_do_not_hold_the_cloth_up(monkeypatch: pytest.MonkeyPatch) -> None:
    raw, cloud = scan("forest", 0.01)
    for company in (2, 3, 4):
        monkeypatch.setattr(ground, "_COMPANY", company)
        precision, recall = measure_points(cloud)
        assert precision > 0.999
        assert recall > 0.995
    assert measure_mesh(raw, cloud) < 0.015
    monkeypatch.setattr(ground, "_COMPANY", 0)
    assert measure_points(cloud)[1] < 0.5
