#!/usr/bin/env python3
"""Fit the probability that a scan is open: `boundary.closing.COEFFICIENTS`.

    HPCAPP_DATA=DIR benchmarks/closing.py [--seed S] [--count N] [--folders raw] [-o FILE]

Of random worlds (see `worlds.py`) and of the folders' scans it is known whether they are closed.
Where it is not, rooms and objects seen in part count as open, and others that came out closed by
the share of that which lies away from what was seen. What is closed but read from inside, or a room
but read from outside, is left out: its sides are wrong, and not its closing. What was found of each
scan is kept in ``rows.jsonl``, here. Fitted by the likelihood with a little damping, over all scans
and ten times without a tenth of them, on which it is then judged.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from tables import parser_of, write_table
from worlds import FAMILIES, load_tool, make_worlds

from hpcapp.applications.surface.boundary.closing import measure_opening
from hpcapp.applications.surface.types.reading import Reading
from hpcapp.geometry.points import BoolArray, FloatArray

_DAMPING = 0.1  # of the coefficients, each divided by the spread of what it is of
_FOLDS = 10  # each of them is judged by what the others fit
_BINS = (0.5, 0.7, 0.9, 0.97, 0.99, 1.0)
_NAMES = ("1", "unsupported share", "missing", "missing and drawn", "amid")
_INVENTED = {"plants": (0.05, 0.1), "works": (0.025, 0.05)}  # below: closed; above: open


def collect(rows: Path, folders: list[Path]) -> list[dict[str, Any]]:
    """Return what is known of each scan, and note it."""
    known = [json.loads(line) for line in rows.read_text().splitlines()] if rows.exists() else []
    done = {row["scan"] for row in known}
    for folder in folders:
        for name, entry in json.loads((folder / "expected.json").read_text()).items():
            scan = str(folder / name)
            if scan in done:
                continue
            job = ["hpcapp", "reconstruct", scan, "-o", f"{rows}.ply", "--json"]
            told = subprocess.run(job, capture_output=True, text=True, check=False)
            report = json.loads(told.stdout) if told.returncode == 0 else {}
            row = {key: entry[key] for key in ("group", "closed")} | {"scan": scan}
            if report.get("open") is False and row["group"] in _INVENTED:
                row["invented"] = measure_invented(Path(f"{rows}.ply"), name, entry, folder)
            known.append(row | {key: report.get(key) for key in ("reading", "unsupported")})
            with rows.open("a") as file:
                file.write(json.dumps(known[-1]) + "\n")
    return known


def measure_invented(mesh: Path, name: str, entry: dict[str, Any], folder: Path) -> float:
    """Return the share of a mesh that lies away from what was seen."""
    judge = load_tool(Path(os.environ["HPCAPP_DATA"]), "judge_worlds").evaluate_raw
    return float(judge.judge(judge.load_mesh(mesh), name, entry, folder)["invented"])


def fit(features: FloatArray, truth: BoolArray) -> FloatArray:
    """Return the coefficients of a logistic, by Newton's method."""
    scale = np.array([1.0, *features[:, 1:].std(axis=0)])
    scaled, coefficients = features / scale, np.zeros(len(scale))
    damping = _DAMPING * np.diag([1e-6, *np.ones(len(scale) - 1)])
    for _ in range(50):
        likely = tell(scaled, coefficients)
        slope = scaled.T @ (truth - likely) - damping @ coefficients
        curve = (scaled.T * (likely * (1.0 - likely))) @ scaled + damping
        coefficients = coefficients + np.linalg.solve(curve, slope)
    found: FloatArray = coefficients / scale
    return found


def tell(features: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Return the probability that each is open."""
    likely: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(features @ coefficients, -50.0, 50.0)))
    return likely


def is_open(row: dict[str, Any]) -> bool | None:
    """Tell whether a scan is open; None where nothing tells, or its sides are wrong."""
    faces_places = Reading.of_json(row["reading"]).share_going_on > 0.5
    if row["closed"] is not None:
        return None if row["closed"] and faces_places else not row["closed"]
    if row["group"] in ("rooms", "object_in_part"):
        return True if faces_places or row["group"] != "rooms" else None
    if "invented" not in row:
        return None
    low, high = _INVENTED[row["group"]]
    return None if low <= row["invented"] <= high else row["invented"] > high


def main() -> None:
    """Collect, fit, judge, and write what came of it."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=59_001)
    parser.add_argument("--count", type=int, default=8, help="worlds of each family")
    parser.add_argument("--folders", nargs="*", default=[], help="of more scans, as raw")
    asked = parser.parse_args()
    data = Path(os.environ["HPCAPP_DATA"])
    folders = [data / name for name in asked.folders]
    for family in FAMILIES:
        folders.append(Path("worlds", family).absolute())
        if not (folders[-1] / "expected.json").exists():
            make_worlds(data, folders[-1], family, asked.seed, asked.count)
    rows = collect(Path("rows.jsonl"), folders)
    rows = [row for row in rows if row["reading"] and is_open(row) is not None]
    readings = [Reading.of_json(row["reading"]) for row in rows]
    shares = [row["unsupported"] for row in rows]
    among = [round(reading.share_going_on) for reading in readings]
    features = np.array([*map(measure_opening, readings, shares, among)])
    truth = np.array([is_open(row) for row in rows])
    folds = np.arange(len(truth)) % _FOLDS
    coefficients, left_out = fit(features, truth), np.zeros(len(truth))
    for fold in range(_FOLDS):
        others = folds != fold
        left_out[~others] = tell(features[~others], fit(features[others], truth[others]))
    certainty, is_right = np.maximum(left_out, 1.0 - left_out), (left_out > 0.5) == truth
    bins = np.digitize(certainty, _BINS[1:-1])
    counts = [np.bincount(bins[kept], minlength=len(_BINS) - 1) for kept in (bins >= 0, is_right)]
    notes = [
        *(f"{name}: {value:.3g}" for name, value in zip(_NAMES, coefficients, strict=True)),
        *(f"wrong: {Path(rows[row]['scan']).name}" for row in np.flatnonzero(~is_right)),
    ]
    write_table(
        asked.output,
        "Open or closed: said how surely, right how often, on scans that were left out",
        ["from", "to", "scans", "right"],
        np.stack([_BINS[:-1], _BINS[1:], *counts], axis=1).tolist(),
        notes,
    )


if __name__ == "__main__":
    main()
