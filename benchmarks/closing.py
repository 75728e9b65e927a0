#!/usr/bin/env python3
"""Fit the probability that a scan is open: `boundary.closing.COEFFICIENTS`.

    benchmarks/closing.py ROWS DIR...

Each DIR has an ``expected.json`` that says of its scans whether they are ``closed``; rooms, of
which it does not, count as open, and what is closed but read from inside is left out: its sides
are wrong, and not its closing. ROWS is a file of one JSON object a scan: what is not in it is
reconstructed, and added. Fitted by the likelihood with a little damping, over all scans and ten
times without a tenth of them, on which it is then judged (`results/closing.json`).
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
_FOLDS = 10  # each of them is judged by what the others fit
_BINS = (0.5, 0.7, 0.9, 0.97, 0.99, 1.0)
_NAMES = ("1", "log odds of the unsupported share", "missing", "missing and drawn", "amid")


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
            report = json.loads(told.stdout) if told.returncode == 0 else {}
            row = {key: entry[key] for key in ("group", "closed")} | {"scan": scan}
            known.append(row | {key: report.get(key) for key in ("reading", "unsupported")})
            with rows.open("a") as file:
                file.write(json.dumps(known[-1]) + "\n")
    return known


def command(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a command, and keep what it says."""
    return subprocess.run(words, capture_output=True, text=True, check=False)


def fit(features: FloatArray, is_open: BoolArray) -> FloatArray:
    """Return the coefficients of a logistic, by Newton's method."""
    scale = np.array([1.0, *features[:, 1:].std(axis=0)])
    scaled, coefficients = features / scale, np.zeros(len(scale))
    damping = _DAMPING * np.diag([1e-6, *np.ones(len(scale) - 1)])
    for _ in range(50):
        likely = tell(scaled, coefficients)
        slope = scaled.T @ (is_open - likely) - damping @ coefficients
        curve = (scaled.T * (likely * (1.0 - likely))) @ scaled + damping
        coefficients = coefficients + np.linalg.solve(curve, slope)
    found: FloatArray = coefficients / scale
    return found


def tell(features: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Return the probability that each is open."""
    likely: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(features @ coefficients, -50.0, 50.0)))
    return likely


def is_told(row: dict[str, Any]) -> bool:
    """Tell whether a scan says how to decide."""
    if row["closed"]:
        return not Reading.of_json(row["reading"]).faces_places
    return row["closed"] is not None or row["group"] == "rooms"


def main() -> None:
    """Collect, fit, judge, and write what came of it."""
    rows = collect(Path(sys.argv[1]), [Path(folder) for folder in sys.argv[2:]])
    rows = [row for row in rows if row["reading"] and is_told(row)]
    readings = [Reading.of_json(row["reading"]) for row in rows]
    shares = [row["unsupported"] for row in rows]
    features = np.array([*map(measure_opening, readings, shares)])
    truth = np.array([not row["closed"] for row in rows])
    folds = np.arange(len(truth)) % _FOLDS
    coefficients, left_out = fit(features, truth), np.zeros(len(truth))
    for fold in range(_FOLDS):
        others = folds != fold
        left_out[~others] = tell(features[~others], fit(features[others], truth[others]))
    certainty, is_right = np.maximum(left_out, 1.0 - left_out), (left_out > 0.5) == truth
    bins = np.digitize(certainty, _BINS[1:-1])
    counts = [np.bincount(bins[kept], minlength=len(_BINS) - 1) for kept in (bins >= 0, is_right)]
    report = {
        "title": "Open or closed: said how surely, right how often, on scans that were left out",
        "machine": "any",
        "commit": command("git", "rev-parse", "--short", "HEAD").stdout.strip(),
        "command": "benchmarks/closing.py ROWS DIR...",
        "columns": ["from", "to", "scans", "right"],
        "rows": np.stack([_BINS[:-1], _BINS[1:], *counts], axis=1).tolist(),
        "notes": [
            *(f"{name}: {value:.3g}" for name, value in zip(_NAMES, coefficients, strict=True)),
            *(f"wrong: {Path(rows[row]['scan']).name}" for row in np.flatnonzero(~is_right)),
        ],
    }
    target = Path(__file__).parent / "results" / "closing.json"
    target.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
