#!/usr/bin/env python3
"""Fit how probable a reading is, to scans whose truth is known: `likelihood.FITTED`.

    HPCAPP_DATA=DIR benchmarks/readings.py --seeds 59001,59002 --count 6 [--folders raw lines]
        [--rows FILE] [-o FILE]
    HPCAPP_DATA=DIR benchmarks/readings.py --judge 59005 --count 6

Of each random world (see `worlds.py`) and scan of the folders, the readings are followed as a job
does, and compared with the true sides. The fit is the maximum of the likelihood that a right one is
true, or none where none is right, with a little damping; five times without a fifth of them, on
which it then shows how often is right what is said. ``--judge`` shows that of
`FITTED` on other seeds.
`tests/benchmarks/test_readings.py` decides the worlds of the fit again, of which
`FILE-worlds.jsonl` has the readings that may be true. Worlds in the file of ``--rows`` are not
measured again: it is of one state of the code.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.optimize import minimize
from tables import Row, parser_of, write_table
from worlds import FAMILIES, load_tool, make_worlds

import hpcapp
from hpcapp.applications.surface.normals import drive
from hpcapp.applications.surface.normals.evidence.likelihood import (
    FITTED,
    FLOOR,
    SENSED,
    UPS,
    Likelihood,
)
from hpcapp.applications.surface.normals.evidence.linked import LinkedPatches
from hpcapp.applications.surface.normals.evidence.readings import (
    find_readings,
    follow_reading,
    measure_level,
)
from hpcapp.applications.surface.normals.evidence.seen_sides import areas_of
from hpcapp.geometry.axes import rotate
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.errors import HpcError

RIGHT = 0.9  # share of the area whose side is right, of a reading that is
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
_PARTS = 5  # each of them is judged by what the others fit
_DAMPING = 0.01  # of the squares of the numbers
_LOOSE = {"power": 0.0, "held": 0.001, "tangle": 0.001}  # of that, for those that are large
_LIKELY = 5.0  # logarithm of the odds: readings that fall behind the best by more are left out
_RARER = {"amid": -0.6, "sensor": -0.6}
"""Logarithm of how much rarer such scans are among those that people bring than among random ones,
of which half are from among things."""
_NAMES = [field.name for field in fields(Likelihood)]
_START = {"around": FITTED.around, "power": 2.0, "facing": 3.0, "held": 3.0, "tangle": 20.0}
_LINEAR = _NAMES.index("facing")


class CaughtError(Exception):
    """The patches of a job, which ends with that."""


def catch_patches(path: Path) -> tuple[Any, ...] | None:
    """Return what a job orients; none where normals are there already, or the file is refused."""

    def catch(*given: Any) -> None:
        raise CaughtError(*given)

    with patch.object(drive, "orient_patches", catch), suppress(HpcError):
        try:
            hpcapp.reconstruct(path, executor="serial")
        except CaughtError as caught:
            return caught.args
    return None


def follow_world(data: Path, folder: Path, name: str, entry: dict[str, Any]) -> Row | None:
    """Return the row of a world: its name, the share of links that are broken, readings, agreement.

    Of each reading its kind, cost, evenness and three of facing, and the share of the area whose
    side it has right; of each two, per cent of the area on which they agree.
    """
    caught = catch_patches(folder / name)
    if caught is None:
        return None
    patches, links, spacing, zero, sensor = caught[:5]
    linked, areas = LinkedPatches(patches, links), areas_of(patches)
    found = [
        follow_reading(linked, one, areas, measure_level(patches))
        for one in find_readings(patches, linked, spacing, zero, sensor)
    ]
    tool = load_tool(data, "judge_worlds").evaluate_raw
    truth = tool.evaluate.Surface(*tool.load_truth(entry, folder)[0])
    back = None if sensor.upright is None else sensor.upright.T
    ends = patches.centres - zero, patches.centres - zero + spacing * patches.normals
    feet, tips = (tool.to_truth(rotate(end, back), entry) for end in ends)
    distances, faces = truth.closest(feet)
    # (r, p): which patches each reading turns round; (p,): which should be.
    turned = np.array([one.sides < 0.0 for one in found])
    should = np.einsum("ij,ij->i", tips - feet, truth.normals[faces]) < 0.0
    judged = areas * (distances < entry["limit"])
    right = (turned == should) @ judged / max(judged.sum(), 1e-300)
    agree = 100.0 * np.array([(turned == one) @ areas for one in turned]) / areas.sum()
    readings = []
    for told, share in zip([one.features for one in found], right, strict=True):
        numbers = np.hstack([told.cost, told.evenness, np.asarray(told.facing), share])
        readings.append([told.kind, *numbers.round(4).tolist()])
    broken = round(linked.share_broken(found[0].sides), 4)
    return [name, broken, readings, agree.round().astype(int).tolist()]


@dataclass(frozen=True, eq=False)
class Table:
    """Worlds (w) and the readings (r) of each, as many as that with the most has."""

    linear: FloatArray  # (w, r, n): what the first n numbers of the fit are multiplied with
    facing: FloatArray  # (w, r, 3): along each of `UPS`
    broken: FloatArray  # (w,)
    right: FloatArray  # (w, r): share of the area
    agree: FloatArray  # (w, r, r): share of the area
    exists: BoolArray  # (w, r)
    sensed: BoolArray  # (w, r): whether its kind is of `SENSED`

    @classmethod
    def of(cls, rows: Sequence[Sequence[Any]]) -> Table:
        """Return the rows of worlds as arrays."""
        shape = len(rows), max(len(row[2]) for row in rows)
        linear, facing = np.zeros((*shape, _LINEAR)), np.zeros((*shape, len(UPS)))
        right, agree = np.zeros(shape), np.zeros((*shape, shape[1]))
        exists, sensed = np.zeros((2, *shape), np.bool_)
        for world, (_, _, readings, shares) in enumerate(rows):
            count = len(readings)
            agree[world, :count, :count] = np.array(shares) / 100.0
            exists[world, :count] = True
            for place, (kind, cost, evenness, *along, share) in enumerate(readings):
                sensed[world, place] = kind in SENSED
                row = linear[world, place]
                row[0] = -np.log(FLOOR + cost)
                if kind != "outside":
                    row[_NAMES.index(kind)] = 1.0
                among = "among" if kind == "amid" else "evenness"
                row[_NAMES.index(among)] = evenness
                facing[world, place] = [sign * along[axis] for axis, sign in UPS]
                right[world, place] = share
        broken = np.array([row[1] for row in rows])
        return cls(linear, facing, broken, right, agree, exists, sensed)

    def take(self, rows: Any) -> Table:
        """Return some of the worlds."""
        return Table(*(getattr(self, field.name)[rows] for field in fields(self)))

    def odds(self, numbers: FloatArray) -> FloatArray:
        """Return the logarithms of the odds of all readings."""
        facing, z_up, y_up, _, _ = numbers[_LINEAR:]
        ups = np.exp(np.array([z_up, y_up, y_up]) + facing * self.facing)
        odds = self.linear @ numbers[:_LINEAR] + np.log1p(ups.sum(axis=-1))
        return np.where(self.exists, odds, -np.inf)

    def shares(self, numbers: FloatArray) -> FloatArray:
        """Return the probabilities of all readings, as `Likelihood.find_shares` does."""
        odds = self.odds(numbers)
        shares = np.exp(odds - odds.max(axis=1, keepdims=True))
        held = 1.0 / (1.0 + np.exp(numbers[-1] * self.broken - numbers[-2]))
        held = np.where(self.sensed, 1.0, held[:, None])
        found: FloatArray = held * shares / shares.sum(axis=1, keepdims=True)
        return found

    def decide(self, numbers: FloatArray) -> tuple[FloatArray, BoolArray, IntArray]:
        """Return how sure the sides of each world are, whether they are right, and whose."""
        # (w, r): of each reading, the shares of all that agree with it.
        sums = np.einsum("wrs,ws->wr", self.agree, self.shares(numbers))
        best = np.argmax(np.where(self.exists, sums, -1.0), axis=1)
        rows = np.arange(len(best))
        return sums[rows, best], self.right[rows, best] > RIGHT, best

    def fit(self) -> FloatArray:
        """Return the most likely numbers, damped."""
        is_right = self.right > RIGHT
        damping = _DAMPING * np.array([_LOOSE.get(name, 1.0) for name in _NAMES])

        def lose(numbers: FloatArray) -> float:
            shares = self.shares(numbers)
            true = np.where(
                is_right.any(axis=1), (shares * is_right).sum(axis=1), 1.0 - shares.sum(axis=1)
            )
            return float(damping @ numbers**2 - np.log(np.maximum(true, 1e-9)).sum())

        start = np.array([_START.get(name, 0.0) for name in _NAMES])
        free = dict.fromkeys(_NAMES, (None, None)) | {"around": (FITTED.around,) * 2}
        bounds = list(free.values())
        found: FloatArray = minimize(lose, start, method="L-BFGS-B", bounds=bounds).x
        found += np.array([_RARER.get(name, 0.0) for name in _NAMES])
        return found


def tabulate(sure: FloatArray, is_right: BoolArray) -> list[Row]:
    """Return how many worlds were said how surely, and how many of these are right."""
    bins = np.digitize(sure, BINS[1:-1])
    counts = [np.bincount(bins[kept], minlength=len(BINS) - 1) for kept in (bins >= 0, is_right)]
    return [list(row) for row in zip(BINS[:-1], BINS[1:], *np.array(counts).tolist(), strict=True)]


def cross_validate(table: Table) -> tuple[FloatArray, BoolArray]:
    """Return `decide` of each world by a fit without it."""
    parts = np.random.default_rng(0).permutation(len(table.broken)) % _PARTS
    sure, is_right = np.zeros(len(parts)), np.zeros(len(parts), np.bool_)
    for part in range(_PARTS):
        held = parts == part
        sure[held], is_right[held] = table.take(held).decide(table.take(~held).fit())[:2]
    return sure, is_right


def drop_unlikely(row: Sequence[Any], odds: FloatArray) -> Row:
    """Return the row of a world with the readings that may be true."""
    kept = np.flatnonzero(odds > odds.max() - _LIKELY).tolist()
    name, broken, readings, agree = row
    return [name, broken, [readings[one] for one in kept],
            [[agree[one][other] for other in kept] for one in kept]]  # fmt: skip


def measure_worlds(data: Path, asked: argparse.Namespace) -> Iterator[Row]:
    """Yield the rows of the worlds of some seeds and of some folders, and keep them."""
    known: dict[str, list[Row | None]] = {}
    if asked.rows is not None and asked.rows.exists():
        known = dict(map(json.loads, asked.rows.read_text(encoding="utf-8").splitlines()))
    seeds = (asked.judge or asked.seeds).split(",")
    families = list(filter(re.compile(asked.only).search, FAMILIES))
    drawn = [f"{family} {seed} {asked.count}" for seed in seeds for family in families]
    for key in [*drawn, *asked.folders]:
        if key not in known:
            print(key, flush=True)
            with tempfile.TemporaryDirectory() as scratch:
                if key in drawn:
                    folder, (family, seed, count) = Path(scratch), key.split()
                    made = make_worlds(data, folder, family, int(seed), int(count))
                else:
                    folder = data / key
                    made = json.loads((folder / "expected.json").read_text(encoding="utf-8"))
                known[key] = [follow_world(data, folder, *one) for one in made.items()]
            if asked.rows is not None:
                with asked.rows.open("a", encoding="utf-8") as file:
                    file.write(json.dumps([key, known[key]]) + "\n")
        yield from filter(None, known[key])


def main() -> None:
    """Measure, fit, judge, and write what came of it."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", default="59001,59002", help="worlds of the fit")
    parser.add_argument("--judge", help="seeds on which the numbers as they stand are judged")
    parser.add_argument("--count", type=int, default=6, help="worlds of each family and seed")
    parser.add_argument("--only", default=".", help="of the families, a regular expression")
    parser.add_argument("--folders", nargs="*", default=[], help="of more scans, as raw and lines")
    parser.add_argument("--rows", type=Path, help="file of what was measured")
    asked = parser.parse_args()
    rows = list(measure_worlds(Path(os.environ["HPCAPP_DATA"]), asked))
    table = Table.of(rows)
    numbers = np.array(astuple(FITTED)) if asked.judge else table.fit()
    sure, is_right = table.decide(numbers)[:2] if asked.judge else cross_validate(table)
    reliability = tabulate(sure, is_right)
    fitted = Likelihood(*(float(f"{number:.3g}") for number in numbers))
    wrong = [f"wrong: {rows[row][0]}, {sure[row]:.2f}" for row in np.flatnonzero(~is_right)]
    counts = " | ".join(f"{right} of {worlds}" for _, _, worlds, right in reliability)
    print(*wrong, fitted, f"| {counts} |", f"{is_right.sum()} of {len(rows)} right", sep="\n")
    if asked.output is None or asked.judge:
        return
    title = "Sides of scans: said how surely, right how often, on those left out of the fit"
    columns = ["from", "to", "worlds", "right"]
    notes = [f"{name}: {number}" for name, number in asdict(fitted).items()]
    write_table(asked.output, title, columns, reliability, notes)
    likely = [drop_unlikely(*one) for one in zip(rows, table.odds(numbers), strict=True)]
    lines = [json.dumps(row, separators=(",", ":")) + "\n" for row in likely]
    worlds = asked.output.with_name(f"{asked.output.stem}-worlds.jsonl")
    worlds.write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
