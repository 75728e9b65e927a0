#!/usr/bin/env python3
"""Show which random scans come out right: worlds of one seed, made, meshed and judged.

    HPCAPP_DATA=DIR benchmarks/worlds.py [--seed S] [--only REGEX] [-o FILE]

A world is a scene, a scanner, a density, a noise, a frame and a format, all drawn by lot, of
sixteen families. It is right, right but warned of (`alarm`), wrong and said, or wrong in silence.
What makes and judges worlds lies in the folder `worlds` of the shared scans; it needs `trimesh` and
`embreex`. `tests/benchmarks/test_worlds.py` holds the table of the default seed.
"""

from __future__ import annotations

import io
import json
import logging
import os
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from tables import Row, parser_of, write_table

import hpcapp
from hpcapp.geometry.mesh import Mesh
from hpccomponent.errors import HpcError

SEED = 60_000
FAMILIES = {
    "whole_object": 7, "object_on_ground": 7, "object_in_part": 7, "rooms": 6, "drone": 7,
    "flown": 7, "streets": 5, "tunnels": 7, "fronts": 7, "works": 3, "sheets": 7, "plants": 5,
    "shells": 4, "volumes": 7, "solids": 7, "sweeps": 7,
}  # fmt: skip
"""How many worlds of each: a hundred in all, fewer of those with the most points."""
KINDS = ("right", "alarm", "said", "silent")

Reconstruct = Callable[[Path], Mesh]


@dataclass(frozen=True)
class Verdict:
    """What came of a world: one of `KINDS`, and what is wrong."""

    name: str
    kind: str
    fails: list[str]


def load_tool(data: Path, name: str) -> Any:
    """Return the module that makes worlds, or the one that judges meshes of them."""
    folder = str(data / "worlds/tools")
    if folder not in sys.path:
        sys.path.append(folder)
    return import_module(name)


def make_worlds(data: Path, folder: Path, family: str, seed: int, count: int) -> dict[str, Any]:
    """Make worlds of a family in an empty folder, and return what is expected of each."""
    tool = load_tool(data, "make_worlds")
    words = f"make_worlds --seed {seed} --count {count} --family ^{family}$ --out".split()
    with patch.object(sys, "argv", [*words, str(folder)]), redirect_stdout(io.StringIO()):
        tool.main()
    expected: dict[str, Any] = json.loads((folder / "expected.json").read_text())
    return expected


def reconstruct(path: Path) -> Mesh:
    """Make a mesh of a world as anyone would."""
    made = hpcapp.reconstruct(path, executor="serial")
    return Mesh(np.asarray(made.vertices, np.float64), np.asarray(made.faces, np.int64))


def judge_world(
    data: Path, folder: Path, name: str, entry: dict[str, Any], make: Reconstruct = reconstruct
) -> Verdict:
    """Make a mesh of a world and judge it; a job that fails says so."""
    tool, log = load_tool(data, "judge_worlds"), logging.getLogger("hpcapp")
    heard = BufferingHandler(sys.maxsize)
    log.addHandler(heard)
    try:
        mesh = make(folder / name)
    except HpcError as error:
        return Verdict(name, "said", [str(error)])
    finally:
        log.removeHandler(heard)
    lines = [record.getMessage() for record in heard.buffer]
    warnings = [line for line in lines if "warning" in line]
    result = tool.evaluate_raw.judge((mesh.vertices, mesh.faces), name, entry, folder)
    return Verdict(name, *tool.kind_of(result | {"warnings": warnings}, entry))


def judge_family(data: Path, family: str, seed: int = SEED) -> Iterator[Verdict]:
    """Yield the verdict of each world of a family."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, entry in make_worlds(data, folder, family, seed, FAMILIES[family]).items():
            yield judge_world(data, folder, name, entry)


def main() -> None:
    """Measure the families of a seed, and write the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", default=".", help="of the families, a regular expression")
    asked = parser.parse_args()
    rows: list[Row] = []
    for family in filter(re.compile(asked.only).search, FAMILIES):
        counts: Counter[str] = Counter()
        for verdict in judge_family(Path(os.environ["HPCAPP_DATA"]), family, asked.seed):
            counts[verdict.kind] += 1
            print(f"{verdict.kind:<7}{verdict.name:<56}{', '.join(verdict.fails)}", flush=True)
        rows.append([family, *(counts[kind] for kind in KINDS)])
        print(" ".join(map(str, rows[-1])), flush=True)
    title = f"Random worlds of seed {asked.seed}: right, also warned of, wrong and said, silent"
    write_table(asked.output, title, ["family", *KINDS], rows)


if __name__ == "__main__":
    main()
