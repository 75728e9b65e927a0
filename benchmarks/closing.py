#!/usr/bin/env python3
"""Fit the probability that a scan is open: `boundary.closing.COEFFICIENTS`.

    benchmarks/closing.py ROWS DIR...

Each DIR has an ``expected.json`` that says of its scans whether they are ``closed``; rooms, of which
it does not, count as open. ROWS is a file of one JSON object a scan: what is not in it is
reconstructed, and added. Fitted by the likelihood with a little damping, over all scans and ten times
without a tenth of them, on which it is then judged (`results/closing.json`).
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.applications.surface.boundary.closing import measure_opening
from hpcapp.applications.surface.types.reading import Reading
from hpcapp.geometry.points import BoolArray, FloatArray

_DAMPING = 0.1  # of the coefficients, each divided by the spread of what it is of
_ROUNDS = 50
_FOLDS = 10  # each of them is judged by what the others fit
_BINS = (0.5, 0.7, 0.9, 0.97, 0.99, 1.0)
_NAMES = ("1", "log odds of the unsupported share", "missing", "drawn", "from among the points")


def collect(rows: Path, folders: list[Path]) -> list[dict[str, Any]]:
    """Return what is known of each scan, and note it."""
    known = [json.loads(line) for line in rows.read_text().splitlines()] if rows.exists() else []
    done = {row["scan"] for row in known}
    for folder in folders:
        for name, entry in json.loads((folder / "expected.json").read_text()).items():
            scan = str(folder / name)
            if scan in done:
                continue
            told = command("hpcapp", "reconstruct", scan, "-o", f"{rows}.ply", "--json")
            row: dict[str, Any] = {"scan": scan, "group": entry["group"], "closed": entry["closed"]}
            if told.returncode == 0:
                report = json.loads(told.stdout)
                row |= {key: report.get(key) for key in ("reading", "unsupported", "open")}
            known.append(row)
            with rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
    return known


def command(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a command, and keep what it says."""
    return subprocess.run(words, capture_output=True, text=True, check=False)


def fit(features: FloatArray, is_open: BoolArray) -> FloatArray:
    """Return the coefficients of a logistic, by Newton's method."""
    scale = np.maximum(features.std(axis=0), 1e-9)
    scale[0] = 1.0
    scaled, coefficients = features / scale, np.zeros(features.shape[1])
    damping = _DAMPING * np.diag([0.0, *np.ones(len(coefficients) - 1)])
    for _ in range(_ROUNDS):
        likely = tell(scaled, coefficients)
        slope = scaled.T @ (is_open - likely) - damping @ coefficients
        curve = (
            (scaled.T * (likely * (1.0 - likely))) @ scaled + damping + 1e-9 * np.eye(len(slope))
        )
        coefficients = coefficients + np.linalg.solve(curve, slope)
    found: FloatArray = coefficients / scale
    return found


def tell(features: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Return the probability that each is open."""
    likely: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(features @ coefficients, -50.0, 50.0)))
    return likely


def main() -> None:
    """Collect, fit, judge, and write what came of it."""
    rows = collect(Path(sys.argv[1]), [Path(folder) for folder in sys.argv[2:]])
    used = [
        row | {"closed": bool(row["closed"])}
        for row in rows
        if row.get("unsupported") is not None
        and (row["closed"] is not None or row["group"] == "rooms")
    ]
    readings = [Reading.of_json(row["reading"]) for row in used]
    shares = [row["unsupported"] for row in used]
    features = np.array([*map(measure_opening, readings, shares)])
    is_open = np.array([not row["closed"] for row in used])
    folds = np.arange(len(used)) % _FOLDS
    coefficients, left_out = fit(features, is_open), np.zeros(len(used))
    for fold in range(_FOLDS):
        others = folds != fold
        left_out[~others] = tell(features[~others], fit(features[others], is_open[others]))
    certainty, is_right = np.maximum(left_out, 1.0 - left_out), (left_out > 0.5) == is_open
    reliability = []
    for low, high in zip(_BINS, _BINS[1:], strict=False):
        rows_in = (certainty >= low) & ((certainty < high) | (high == 1.0))
        reliability.append([low, high, int(rows_in.sum()), int(is_right[rows_in].sum())])
    report = {
        "title": "Open or closed: said how surely, right how often, on scans that were left out",
        "machine": "any: it does not matter",
        "commit": command("git", "rev-parse", "--short", "HEAD").stdout.strip(),
        "command": "benchmarks/closing.py ROWS DIR...",
        "columns": ["from", "to", "scans", "right"],
        "rows": reliability,
        "notes": [
            *(f"{name}: {value:.3g}" for name, value in zip(_NAMES, coefficients, strict=True)),
            *(f"wrong: {Path(used[row]['scan']).name}" for row in np.flatnonzero(~is_right)),
        ],
    }
    Path(__file__).with_name("results").joinpath("closing.json").write_text(
        json.dumps(report, indent=1) + "\n"
    )
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
