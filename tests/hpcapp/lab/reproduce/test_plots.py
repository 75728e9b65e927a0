"""Figures 7 and 8: their tables and pictures."""

from __future__ import annotations

from io import BytesIO

import pytest

from hpcapp.lab.reproduce.finding import Finding
from hpcapp.lab.reproduce.plots import make_figure_7, make_figure_8
from hpcapp.lab.reproduce.scaling import WAYS, ScalingRun


def run_of(way: str, workers: int, number: int, fit_s: float, job_s: float) -> ScalingRun:
    return ScalingRun(
        way, workers, number, 0.5 * workers, 2.0 * fit_s, fit_s, job_s, 2_000_000 * workers
    )


@pytest.fixture(scope="module")
def runs() -> list[ScalingRun]:
    """Three rounds, the second of which a busy machine makes ten times as slow."""
    return [
        run_of(way, workers, number, slow * fit_s, slow * job_s)
        for number, slow in enumerate((1.0, 10.0, 1.0))
        for workers, fit_s, job_s in ((0, 0.1, 1.0), (1, 0.2, 1.1), (2, 0.4, 1.3))
        for way in WAYS
    ]


@pytest.fixture(scope="module")
def made(runs: list[ScalingRun]) -> dict[str, tuple[Finding, bytes]]:
    pytest.importorskip("matplotlib", reason="needs the plots extra")
    found = {}
    for name, make in (("fig7", make_figure_7), ("fig8", make_figure_8)):
        file = BytesIO()
        found[name] = make(runs, "a sphere", 2, file), file.getvalue()
    return found


def test_the_times_are_those_of_all_rounds(made: dict[str, tuple[Finding, bytes]]) -> None:
    finding, _ = made["fig7"]
    assert [row[0] for row in finding.rows] == ["0 (the master alone)", "1", "2"]
    assert {len(row) for row in finding.rows} == {len(finding.columns)}
    assert finding.rows[1] == (
        "1", "0.50 (0.50 to 0.50)", "400 (400 to 4000)", "200 (200 to 2000)",
        "1.10 (1.10 to 11.00)", "1.10 (1.10 to 11.00)", "2.0", "2.0", "-",
    )  # fmt: skip
    assert "10.0 % of the paper's method is in its fits" in finding.sentence


def test_a_slow_round_leaves_the_speedups_alone(made: dict[str, tuple[Finding, bytes]]) -> None:
    finding, _ = made["fig8"]
    assert finding.rows[2] == (
        "2", "0.25 (0.25 to 0.25)", "0.77 (0.77 to 0.77)", "1.05", "0.77 (0.77 to 0.77)", "-",
    )  # fmt: skip


def test_the_papers_own_words_stand_beside_four_workers() -> None:
    pytest.importorskip("matplotlib", reason="needs the plots extra")
    runs = [run_of(way, workers, 0, 0.1, 1.0) for workers in (0, 4) for way in WAYS]
    for make in (make_figure_7, make_figure_8):
        finding = make(runs, "a sphere", 1, BytesIO())
        assert [row[-1] for row in finding.rows] == ["-", "almost double"]
        assert "share 1 core," in finding.sentence
        assert "Step 1, to denoise and resample, is off" in finding.sentence


@pytest.mark.parametrize("name", ["fig7", "fig8"])
def test_figures_are_small_pictures(name: str, made: dict[str, tuple[Finding, bytes]]) -> None:
    _, picture = made[name]
    assert picture.startswith(b"\x89PNG")
    assert len(picture) < 150_000
