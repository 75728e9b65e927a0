"""A forecast gives back the rates that it was made of, and says what holds a job up."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

import forecast
import pytest
from forecast import (
    HaloTraffic,
    JobSize,
    MeasuredRun,
    Rates,
    Scaling,
    fit_halo,
    fit_rates,
)

RATES = Rates(1.0, 3e-6, 1e-6, 0.5, 1e-7, 0.01, 0.5)
GRID = 1024


def run_of(machines: int, points: int) -> MeasuredRun:
    """Return a run that costs what `RATES` say."""
    tiles = 4 * machines or 1
    halos = RATES.halo_share(tiles, GRID) * points
    work = RATES.point * points + RATES.halo_point * halos
    head = RATES.head_start + RATES.head_point * points + RATES.head_tile * tiles
    return MeasuredRun(
        "shared" if machines else "serial",
        machines,
        head if machines else RATES.start + RATES.point * points,
        [RATES.start + work / machines] * machines if machines else [],
        JobSize(points, tiles),
    )


@pytest.fixture
def results() -> list[Scaling]:
    return [
        Scaling(GRID, [run_of(count, points) for count in (0, 4, 8)]) for points in (10**6, 10**7)
    ]


def test_rates_are_found_again(results: list[Scaling]) -> None:
    rates = fit_rates(results, RATES.halo)
    for name in ("start", "point", "halo_point", "head_start", "head_point", "head_tile"):
        assert getattr(rates, name) == pytest.approx(getattr(RATES, name), rel=1e-3)


def test_the_halo_is_that_of_squares() -> None:
    sent = {"sum_tile: own points": 1e8, "mesh_tile: halo": RATES.halo_share(9, GRID) * 1e8}
    assert fit_halo(HaloTraffic(9, GRID, sent)) == pytest.approx(RATES.halo)


def test_what_is_scarce_holds_the_job_up() -> None:
    few = forecast.forecast(RATES, 1e9, GRID, 8, 1, 1e6)
    assert (few.bottleneck, few.tiles) == ("workers", 400)
    assert few.worker_s > 1e9 * RATES.point / 8
    assert forecast.forecast(RATES, 1e9, GRID, 8, 1, 10).bottleneck == "folder"
    many = forecast.forecast(RATES, 1e8, GRID, 512, 16, 1e6)
    assert many.bottleneck == "head"
    assert many.total_s == pytest.approx(many.worker_s + many.head_s)


def test_the_command_prints_a_line_for_each_number_of_machines(
    results: list[Scaling],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    sent = {"sum_tile: own points": 2.0, "mesh_tile: halo": 1.0}
    (tmp_path / "traffic.json").write_text(json.dumps({"tiles": 4, "grid": GRID, "sent": sent}))
    for number, result in enumerate(results):
        (tmp_path / f"{number}.json").write_text(json.dumps(asdict(result)))
    words = [str(tmp_path / f"{number}.json") for number in range(2)]
    words = ["forecast.py", *words, "--traffic", str(tmp_path / "traffic.json")]
    monkeypatch.setattr(sys, "argv", words)
    forecast.main()
    rates, _, *table = capsys.readouterr().out.splitlines()
    assert rates.startswith("start 1, point 3e-06")
    assert [row.split("|")[1].strip() for row in table[2:]] == ["8", "64", "512"]
