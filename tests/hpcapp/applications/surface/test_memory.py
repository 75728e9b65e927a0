from __future__ import annotations

import pytest

from hpcapp.applications.surface import memory
from hpcapp.applications.surface.memory import check_memory, estimate_memory
from hpccomponent.errors import UsageError
from hpccomponent.surface.types.points import PointCloud


def test_a_volume_grows_with_the_third_power_and_a_surface_with_the_second(
    sphere: PointCloud,
) -> None:
    for method, power in (("paper", 3), ("hierarchical", 2)):
        ratio = estimate_memory(method, 2048, sphere) / estimate_memory(method, 1024, sphere)
        assert ratio == pytest.approx(2.0**power, rel=0.2)


def test_what_does_not_fit_is_refused_with_what_does(
    sphere: PointCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "available_memory", lambda: 8.0 * 2**30)
    check_memory("hierarchical", 512, sphere)
    with pytest.raises(UsageError, match=r"choose --grid (\d+) or smaller") as caught:
        check_memory("paper", 4096, sphere)
    fitting = int(caught.value.advice.split()[2])
    assert 256 < fitting < 4096
    check_memory("paper", fitting, sphere)


def test_a_system_that_does_not_say_refuses_nothing(
    sphere: PointCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "available_memory", lambda: None)
    check_memory("paper", 4096, sphere)
