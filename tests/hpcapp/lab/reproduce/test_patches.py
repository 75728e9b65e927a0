"""Figure 4: the paper's four counts beside the readings that come nearest."""

from __future__ import annotations

import pytest
from shared_data import shared

from hpcapp.lab.reproduce.patches import make_figure_4
from hpcapp.lab.reproduce.subject import open_subject
from hpcapp.progress import Progress, StageClock


@pytest.mark.slow
def test_all_four_counts_have_their_nearest_reading() -> None:
    pytest.importorskip("matplotlib", reason="needs the plots extra")
    with open_subject(shared("bunny_35947.ply")) as subject:
        finding, _ = make_figure_4(subject, "y", StageClock(Progress()))
    assert [row[1] for row in finding.rows] == ["4", "115", "237", "2,727"]
    assert [row[2:5] for row in finding.rows] == [
        ("240", "2,488", "3"), ("240", "2,488", "7"), ("254", "2,488", "64"),
        ("683", "2,556", "582"),
    ]  # fmt: skip
    nearest = [row[5].split(",")[0] for row in finding.rows[:3]]
    assert nearest == ["none is near: 3", "none is near: 240", "254"]  # as the picture shows them
    assert finding.rows[3][5].startswith("2,556, complement")
    assert "No reading gives 4 or 115" in finding.sentence
