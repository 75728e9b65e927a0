"""A forecast gives back the rates that it was made of, and says what holds a job up."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import forecast
import pytest
from forecast import Rates, fit_halo, fit_rates

RATES = Rates(1.0, 3e-6, 1e-6, 0.5, 1e-7, 0.01, 0.5)
GRID = 1024


def run_of(machines: int, points: int) -> dict[str, Any]:
    """Return a run that costs what `RATES` say."""
    tiles = 4 * machines or 1
    halos = RATES.halo_share(tiles, GRID) * points
    work = RATES.point * points + RATES.halo_point * halos
    head = RATES.head_start + RATES.head_point * points + RATES.head_tile * tiles
    return {
        "variant": "shared" if machines else "serial",
        "machines": machines,
        "head_cpu_s": head if machines else RATES.start + RATES.point * points,
        "worker_cpu_s": [RATES.start + work / machines] * machines if machines else [],
        "report": {"points": points, "tiles": tiles},
    }


@pytest.fixture
def results() -> list[dict[str, Any]]:
    return [
        {"grid": GRID, "runs": [run_of(count, points) for count in (0, 4, 8)]}
        for points in (10**6, 10**7)
    ]


def test_rates_are_found_again(results: list[dict[str, Any]]) -> None:
    found = fit_rates(results, RATES.halo)
    for name in ("start", "point", "halo_point", "head_start", "head_point", "head_tile"):
        assert getattr(found, name) == pytest.approx(getattr(RATES, name), rel=1e-3)


def test_the_halo_is_that_of_squares() -> None:
    own = 1e8
    sent = {"sum_tile: own points": own, "mesh_tile: halo": RATES.halo_share(9, GRID) * own}
    assert fit_halo({"tiles": 9, "grid": GRID, "sent": sent}) == pytest.approx(RATES.halo)


def test_what_is_scarce_holds_the_job_up() -> None:
    few = forecast.forecast(RATES, 1e9, GRID, 8, 1, 1e6)
    assert (few.bottleneck, few.tiles) == ("workers", 400)
    assert few.worker_s > 1e9 * RATES.point / 8
    assert forecast.forecast(RATES, 1e9, GRID, 8, 1, 10).bottleneck == "folder"
    many = forecast.forecast(RATES, 1e8, GRID, 512, 16, 1e6)
    assert many.bottleneck == "head"
    assert many.total_s == pytest.approx(many.worker_s + many.head_s)


def test_the_command_prints_a_line_for_each_number_of_machines(
    results: list[dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    sent = {"sum_tile: own points": 2.0, "mesh_tile: halo": 1.0}
    (tmp_path / "traffic.json").write_text(json.dumps({"tiles": 4, "grid": GRID, "sent": sent}))
    for number, result in enumerate(results):
        (tmp_path / f"{number}.json").write_text(json.dumps(result))
    words = [str(tmp_path / f"{number}.json") for number in range(2)]
    words = ["forecast.py", *words, "--traffic", str(tmp_path / "traffic.json")]
    monkeypatch.setattr(sys, "argv", words)
    forecast.main()
    rates, _, *table = capsys.readouterr().out.splitlines()
    assert rates.startswith("start 1, point 3e-06")
    assert [row.split("|")[1].strip() for row in table[2:]] == ["8", "64", "512"]
