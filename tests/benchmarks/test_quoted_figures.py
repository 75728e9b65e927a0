"""Every figure that README and docs quote has a file, and every file a commit of this history.

How old a file is, `benchmarks/measure.py --list` tells: no test fails for it, since history grows
with every commit.
"""

from __future__ import annotations

import datetime
import json
import re
from pathlib import Path
from typing import Any

import measure
import pytest
from tables import RESULTS, ROOT, ask_git

FILES = sorted(RESULTS.glob("*.json"))
PAGES = [ROOT / "README.md", ROOT / "benchmarks/README.md", *sorted(ROOT.glob("docs/*/*.md"))]
SOURCES = [path for folder in ("hpcapp", "benchmarks") for path in ROOT.glob(f"{folder}/**/*.py")]
KEYS = {"title", "machine", "commit", "date", "command", "columns", "rows", "notes"}
RESULT = re.compile(r"generated/benchmarks\.md#([\w-]+)|benchmarks/results/([\w-]+)\.json")
SCRIPT = re.compile(r"(?<!tests/)benchmarks/(\w+\.py)")


def read_result(name: str) -> Any:
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def read_page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def find_quoted(text: str) -> set[str]:
    """Return the results that a page or a paragraph names."""
    return {one or other for one, other in RESULT.findall(text)}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_file_names_its_origin_and_fills_its_columns(path: Path) -> None:
    result = json.loads(path.read_text(encoding="utf-8"))
    assert set(result) == KEYS
    assert all(result[key] for key in KEYS - {"notes"})
    assert re.fullmatch(r"[0-9a-f]{7,40}", result["commit"])
    assert datetime.date.fromisoformat(result["date"])
    assert {len(row) for row in result["rows"]} == {len(result["columns"])}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_file_is_of_a_commit_of_this_history(path: Path) -> None:
    if ask_git("rev-parse", "--is-shallow-repository") != "false":
        pytest.skip("no whole history of git is here")
    commit = json.loads(path.read_text(encoding="utf-8"))["commit"]
    assert ask_git("merge-base", "--is-ancestor", commit, "HEAD") is not None


def test_one_command_makes_every_file() -> None:
    assert {path.stem for path in FILES} <= {result.name for result in measure.TABLE}
    for result in measure.TABLE:
        assert (ROOT / "benchmarks" / result.command.split()[0]).is_file()


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_what_a_page_quotes_has_a_file(path: Path) -> None:
    assert find_quoted(path.read_text(encoding="utf-8")) <= {file.stem for file in FILES}


@pytest.mark.parametrize("path", [*PAGES, *SOURCES], ids=lambda path: path.name)
def test_a_script_that_is_named_is_there(path: Path) -> None:
    for script in SCRIPT.findall(path.read_text(encoding="utf-8")):
        assert (ROOT / "benchmarks" / script).is_file(), script


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_a_paragraph_with_figures_of_a_script_names_the_file(path: Path) -> None:
    if path.parent.name == "benchmarks":
        pytest.skip("its tables stand below it")
    for paragraph in path.read_text(encoding="utf-8").split("\n\n"):
        if SCRIPT.search(paragraph) and re.search(r"\d", paragraph):
            assert find_quoted(paragraph), paragraph[:80]


def find_figures(pattern: str, text: str) -> list[float]:
    """Return the numbers of the sentence that the pattern finds."""
    found = re.search(pattern, text)
    assert found, pattern
    return [float(one.replace(",", "")) for one in found.groups()]


def find_mean(subject: str) -> float:
    """Return our mean error by a peer's, as the notes of the scans tell it."""
    return find_figures(rf"{subject}: ([\d.]+), worst", "\n".join(read_result("scans")["notes"]))[0]


def round_all(values: Any, digits: int = 2) -> list[float]:
    return [round(float(value), digits) for value in values]


def tell_front_errors() -> list[float]:
    means = map(find_mean, ("pypoisson2:8", "Open3D's best depth", "pymeshlab:8"))
    return round_all(1.0 / mean for mean in means)


def tell_front_costs() -> list[float]:
    ratios = [row[3] for row in read_result("cost")["rows"]]
    return [min(ratios), max(ratios)]


def tell_scan_errors() -> list[float]:
    noises = (find_mean(f"{level} noise") for level in ("low", "medium", "high"))
    return round_all([find_mean("Open3D's best depth"), *noises])


def tell_handles() -> list[float]:
    rows = [row[1:] for row in read_result("decisions-handles")["rows"]]
    right = [sum(row[at] == row[1] for row in rows) for at in (3, 0)]
    many = [sum(max(row[at] - row[1], 0) for row in rows) for at in (0, 3, 2)]
    lost = [sum(max(min(row[:2]) - row[at], 0) for row in rows) for at in (4, 3)]
    return [len(rows), *right, *many, *lost]


def tell_moving() -> list[float]:
    return [figure for row in read_result("moving")["rows"]
            for figure in (round(100 * row[3]), row[4])]  # fmt: skip


def tell_alignment() -> list[float]:
    offs = [row[1] for row in read_result("alignment")["rows"] if row[1] != "-"]
    return [len(offs), sum(off <= 0.5 for off in offs), sum(off <= 0.7 for off in offs) - 12]


def tell_ground() -> list[float]:
    rows = [row for row in read_result("ground")["rows"] if row[1] == 0.01]
    recall, precision = (int(1000 * min(row[at] for row in rows)) / 10 for at in (3, 2))
    return [recall, precision, 1000 * max(float(row[4]) for row in rows)]


HOW_MUCH = r"([\d.]+) %.*? (\.\d+) %.*?"
CLAIMS = {
    "README.md: errors": (
        r"mean error, ours = 1 \| \*\*1\*\* \| ([\d.]+) \| ([\d.]+) . \| ([\d.]+)",
        tell_front_errors,
    ),
    "README.md: costs": (r"Open3D takes ([\d.]+) to ([\d.]+) times our CPU", tell_front_costs),
    "docs/explanation/hierarchical.md: errors": (
        r"mean error is ([\d.]+) of that .*?; ([\d.]+), ([\d.]+) and ([\d.]+) at low, medium and",
        tell_scan_errors,
    ),
    "docs/explanation/stitching.md: handles": (
        r"Of (\d+) scans with.*?, (\d+) have the right.*?, and (\d+) without it; of (\d+) "
        r"handles too many (\d+) are left. .*? (\d+) are left, .*? lost: (\d+) instead of (\d+)\.",
        tell_handles,
    ),
    "docs/explanation/robustness.md: moving": (
        rf"(?s)benchmarks\.md#moving.*?people \| {HOW_MUCH * 4}", tell_moving,
    ),
    "docs/explanation/alignment.md: pairs": (
        r"Of the \[(\d+) .*? (\d+) are right to half a spacing and (\d+) to \.7", tell_alignment,
    ),
    "docs/how-to/cut-to-what-was-asked.md: ground": (
        r"([\d.]+) % of the ground are kept and ([\d.]+) % of what .*? within (\d+) mm",
        tell_ground,
    ),
}  # fmt: skip


@pytest.mark.parametrize("claim", CLAIMS)
def test_a_sentence_quotes_its_file(claim: str) -> None:
    pattern, tell = CLAIMS[claim]
    assert find_figures(pattern, read_page(claim.partition(":")[0])) == tell()
