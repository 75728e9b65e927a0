"""Files as people have them: each gives what must come of it, or is refused in so many words."""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shared_data

from hpcapp.cli import main
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_whole
from hpcapp.io.points.inputs import gather_points

Told = tuple[int, str, str]
Tell = Callable[[Path], Told]

FOLDER = shared_data.FOLDER / "real"
VERDICTS = (
    "right",
    "refused",
    "wrong, and said",
    "wrong without a word",
    "refused though readable",
)

KNOWN_UNITS = ("m", "ft", "US ft")
# What these files say of themselves, which is wrong; the first has other units across and up.
STATED_UNITS = {"las/1.2-with-color.copc.laz": "m", "las/lots_of_vlr.las": "US ft"}

# Its line of names has 28 of them, as all others have numbers: there is nothing to warn of.
NOT_ODD = "text/autzen-bmx-m3c2.txt"
# One of its two scans has colours; they are kept, and the points of the other are white.
COLOURED = "e57/A_B_different_dims.e57"
# Their normals have no common side: .33 and .18 of the neighbours oppose each other.
CONTRADICTING = ("text/car_cloud400.csv", "pcd/colored_cloud.pcd")
# A single scan line: it is read, and nothing can be made of it.
LINE = "las/simple1_3.las"


def read_expected() -> dict[str, dict[str, object]]:
    """Return what must come of each file, by its name in the folder."""
    expected: dict[str, dict[str, object]] = {}
    for part in ("", "odd"):
        listed = FOLDER / part / "expected.json"
        if listed.exists():
            for name, facts in json.loads(listed.read_text()).items():
                expected[f"{part}/{name}" if part else name] = facts
    return expected


EXPECTED = read_expected()


@pytest.fixture
def tell(capsys: pytest.CaptureFixture[str]) -> Iterator[Tell]:
    """Run ``hpcapp info --json`` in this process; return its exit code, stdout and stderr."""

    def tell(path: Path) -> Told:
        with pytest.raises(SystemExit) as left:
            main(["info", str(path), "--json"])
        assert isinstance(left.value.code, int)
        return left.value.code, *capsys.readouterr()

    yield tell
    logging.captureWarnings(False)
    logging.raiseExceptions = True
    logging.getLogger().handlers.clear()


@pytest.fixture(scope="module")
def tally(request: pytest.FixtureRequest) -> Iterator[dict[str, str]]:
    """Collect a verdict on each file; ``pytest -s`` shows a table of them in the end."""
    verdicts: dict[str, str] = {}
    yield verdicts
    terminal = request.config.pluginmanager.get_plugin("terminalreporter")
    if terminal is None:
        return
    folders = {name: name.partition("/")[0] for name in verdicts}
    terminal.write_line(f"\n{'folder':8}" + "".join(f"{verdict:>25}" for verdict in VERDICTS))
    for folder in [*dict.fromkeys(folders.values()), "all"]:
        counts = Counter(
            verdict for name, verdict in verdicts.items() if folder in (folders[name], "all")
        )
        terminal.write_line(f"{folder:8}" + "".join(f"{counts[v]:25}" for v in VERDICTS))


@pytest.mark.parametrize("name", EXPECTED or ["expected.json"])
def test_what_must_come_of_a_file_comes_of_it(name: str, tell: Tell, tally: dict[str, str]) -> None:
    path = shared_data.shared(f"real/{name}")
    expected = EXPECTED[name]
    code, stdout, stderr = tell(path)
    assert "Traceback" not in stderr
    assert "internal error" not in stderr
    if code:
        mistakes = list(find_mistakes_of_refusal(name, expected, stderr))
        tally[name] = "refused though readable" if mistakes else "refused"
    else:
        warnings = [line for line in stderr.splitlines() if line.startswith("warning: ")]
        facts = json.loads(stdout)
        with gather_points([str(path)]) as path:
            cloud = read_whole(open_points(path))
        mistakes = [
            *find_mistakes_of_outcome(name, expected, warnings),
            *find_mistakes_of_facts(name, expected, facts),
            *find_mistakes_of_points(expected, facts, cloud),
        ]
        tally[name] = "right" if not mistakes else VERDICTS[2 if warnings else 3]
    assert not mistakes


def find_mistakes_of_refusal(name: str, expected: dict[str, Any], stderr: str) -> Iterator[str]:
    """Yield what is wrong about a refusal."""
    lines = [line for line in stderr.splitlines() if line.startswith("hpcapp: ")]
    if "refuse" not in expected["outcome"]:
        yield f"must not be refused: {stderr}"
    elif len(lines) != 1 or Path(name).name not in lines[0]:
        yield f"one line must name the file: {stderr}"
    elif expected.get("says", "").lower() not in lines[0].lower():
        yield f"{expected['says']!r} must be said: {stderr}"


def find_mistakes_of_outcome(
    name: str, expected: dict[str, Any], warnings: list[str]
) -> Iterator[str]:
    """Yield what is wrong about warnings, or that there are none."""
    outcome = "warn" if warnings else "read"
    is_known = name in (NOT_ODD, *STATED_UNITS)
    is_known |= name == LINE and all("lie on a line" in line for line in warnings)
    if outcome not in expected["outcome"] and not is_known:
        yield f"the outcome must be one of {expected['outcome']}: {warnings}"
    if warnings and expected.get("says", "").lower() not in "\n".join(warnings).lower():
        yield f"{expected['says']!r} must be said: {warnings}"


def find_mistakes_of_facts(
    name: str, expected: dict[str, Any], facts: dict[str, Any]
) -> Iterator[str]:
    """Yield what is wrong of that which is told of a file beside its points."""
    for reason, count in expected.get("dropped", {}).items():
        if facts["dropped"].get(reason) != count:
            yield f"{count} points must be dropped as {reason!r}: {facts['dropped']}"
    if "scans" in expected and len(facts["scans"]) != expected["scans"]:
        yield f"there must be {expected['scans']} scans: {facts['scans']}"
    for place, scan in zip(expected.get("scanners", ()), facts["scans"], strict=False):
        if scan["scanner"] is None and not any(place):
            continue  # that a scanner stood at the origin of an export need not be
        if scan["scanner"] is None or not np.allclose(scan["scanner"], place, atol=1e-5):
            yield f"a scanner must stand at {place}: {scan['scanner']}"
    if "grid" in expected and facts["grid"] != expected["grid"]:
        yield f"the grid must be {expected['grid']}: {facts['grid']}"
    unit = STATED_UNITS.get(name, expected.get("unit"))
    if unit in KNOWN_UNITS and facts["unit"] not in (None, unit):  # many files do not say it
        yield f"the unit must be {unit!r}: {facts['unit']!r}"
    if facts["has_colours"] != bool(expected.get("colours") or name == COLOURED):
        yield f"colours must be {expected.get('colours')}"
    if not expected["points"]:
        return
    wanted = "file" if "axis_normal" in expected else expected.get("normals")
    if facts["normals"] != wanted and expected.get("says") != "normal":
        yield f"normals must be from {wanted}: {facts['normals']}"
    has_sides = "axis_normal" not in expected and name not in CONTRADICTING
    if facts["normals"] and facts["is_oriented"] != has_sides:
        yield f"is_oriented must not be {facts['is_oriented']}"


def find_mistakes_of_points(
    expected: dict[str, Any], facts: dict[str, Any], cloud: PointCloud
) -> Iterator[str]:
    """Yield what is wrong of the points."""
    columns = [cloud.positions, *([] if cloud.normals is None else [cloud.normals])]
    usable = cloud.take(np.flatnonzero(np.isfinite(np.hstack(columns)).all(axis=1)))
    if len(usable) != (expected["points"] or 0) or facts["points"] != len(cloud):
        yield f"there must be {expected['points']} points: {len(usable)} of {facts['points']}"
        return
    if not len(usable):
        return
    positions = usable.positions + cloud.origin
    found = {
        "min": positions.min(axis=0), "max": positions.max(axis=0),
        "first": positions[0], "last": positions[-1],
    }  # fmt: skip
    for key in ("min", "max") if expected.get("bounds_only") else found:
        if not np.allclose(found[key], expected[key], rtol=1e-9, atol=1e-5):
            yield f"{key} must be {expected[key]}: {found[key]}"
    for key, row in (("first_colour", 0), ("last_colour", -1)):
        if expected.get("colours") and usable.colours is not None and key in expected:
            colour = usable.colours[row].astype(int)
            if np.abs(colour - expected[key]).max() > 1:
                yield f"{key} must be {expected[key]}: {colour}"
    if usable.normals is not None:
        yield from find_mistakes_of_normal(expected, usable.normals[0])


def find_mistakes_of_normal(expected: dict[str, Any], normal: FloatArray) -> Iterator[str]:
    """Yield what is wrong of the first normal."""
    if "first_normal" in expected:
        is_raw = np.allclose(normal, expected["first_normal"], atol=1e-4)
        if is_raw == (expected.get("says") == "normal"):  # they are wrong in the file, then
            yield f"the first normal must not be {normal}: {expected['first_normal']}"
    if "axis_normal" in expected:
        axis = np.array(expected["axis_normal"])
        if abs(normal @ axis) < 1 - 1e-5:
            yield f"the first axis must be {axis}: {normal}"
