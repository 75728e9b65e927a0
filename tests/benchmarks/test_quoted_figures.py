"""The figures that the front page and the method's page quote are those of the results."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def read_result(name: str) -> Any:
    return json.loads((ROOT / f"benchmarks/results/{name}.json").read_text(encoding="utf-8"))


def find_figure(pattern: str) -> float:
    """Return the figure that the notes of the scans tell."""
    match = re.search(pattern, " ".join(read_result("scans")["notes"]))
    assert match, pattern
    return float(match[1])


def test_the_front_pages_errors_are_those_of_the_scans() -> None:
    row = re.search(r"mean error, ours = 1 (.*)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert row
    ours, poisson, open3d, meshlab = map(float, re.findall(r"\d[\d.]*", row[1])[:4])
    assert ours == 1.0
    assert poisson == round(1.0 / find_figure(r"PoissonRecon [\d.]+ \(.*?\) ([\d.]+), worst"), 2)
    assert open3d == round(1.0 / find_figure(r"all \(60\): L1 by the best peer ([\d.]+)"), 2)
    assert meshlab == round(1.0 / find_figure(r"MeshLab's \(.*?\) ([\d.]+), worst"), 2)


def test_the_front_pages_times_are_those_beside_open3d() -> None:
    told = re.search(
        r"Open3D takes ([\d.]+) to ([\d.]+) times our CPU time",
        (ROOT / "README.md").read_text(encoding="utf-8"),
    )
    assert told
    ratios = []
    for row in read_result("poisson-cost")["rows"]:
        ours, theirs = map(float, row[3].split(" / "))
        ratios.append(round(theirs / ours, 1))
    assert (float(told[1]), float(told[2])) == (min(ratios), max(ratios))


def test_the_methods_page_quotes_the_scans() -> None:
    page = (ROOT / "docs/explanation/hierarchical.md").read_text(encoding="utf-8")
    best = find_figure(r"all \(60\): L1 by the best peer ([\d.]+)")
    assert f"the mean error is {best:.2f} of that of the best" in page
    topology = find_figure(r"all \(60\):.*?right topology in (\d+)")
    assert f"The topology is right in {topology:.0f}" in page
    noises = [find_figure(rf"{name} \(17\): L1 by the best peer ([\d.]+)")
              for name in ("low", "medium", "high")]  # fmt: skip
    assert "{:.2f}, {:.2f} and {:.2f} at low, medium and high noise".format(*noises) in page
