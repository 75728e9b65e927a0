#!/usr/bin/env python3
"""Show what tells small pieces of a mesh from its parts: the areas of both.

    HPCAPP_DATA=DIR benchmarks/pieces.py [--only REGEX] [-o FOLDER]

Of each scan, how many pieces its mesh has; how many of them are parts that were scanned as a whole
(a room and its table, a ground and its roofs), as the scan's maker knows; the area of the least of
these and of the largest other piece, as shares of the area of the largest piece; and how many are
small by half of `SMALL`, by itself and by its double (`decisions-pieces.json`). Of scans that fall
into shreds of every size (leaves, pipes, water, one view) nobody can say what a part is: they have
a 0 there. `tests/benchmarks/test_decisions.py` holds the margins.
"""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path

import numpy as np
from tables import Row, write_table

import hpcapp
from hpcapp.api.mesh import unwrap_mesh
from hpcapp.geometry.pieces import SMALL
from hpcapp.mending.pieces import measure_pieces

PARTS = {
    "raw/objects/two_near.ply": 2,  # two balls
    "raw/rooms/furnished_z_up.ply": 2,  # the room, the table
    "raw/rooms/kitchen.ply": 2,  # likewise
    "raw/rooms/facade.ply": 3,  # the house, a balcony, a window
    "raw/rooms/no_ceiling.ply": 1,
    "cases/table_ball.xyz": 2,  # the table, the ball
    "raw/airborne/town.laz": 15,  # the ground, 14 roofs
    "raw/airborne/town_dense.laz": 5,  # the ground, 4 roofs
    "kinect_table.ply": 0,
    "real/las/lion_takanawa.copc.laz": 0,
    "real/ply/pond.0.ply": 0,
    "real/e57/pumpAVisualReferenceImage.e57": 0,
}
COLUMNS = ["scan", "pieces", "parts", "least part", "largest shred", "in half", "in one", "in two"]


def find_pieces(path: Path, parts: int) -> Row:
    """Return the row of a scan."""
    mesh = hpcapp.reconstruct(path, attributes="none")
    areas = np.sort(measure_pieces(unwrap_mesh(mesh))[1])[::-1]
    shares = areas / areas[0]
    least = float(f"{shares[parts - 1]:.3g}") if parts else ""
    shred = float(f"{shares[parts]:.3g}") if 0 < parts < len(shares) else ""
    counts = [int((shares < factor * SMALL).sum()) for factor in (0.5, 1.0, 2.0)]
    return [path.name.split(".")[0], len(shares), parts, least, shred, *counts]


def main() -> None:
    """Measure all scans, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default=".")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/results"))
    asked = parser.parse_args()
    data, rows = Path(os.environ["HPCAPP_DATA"]), []
    for name, parts in PARTS.items():
        if re.search(asked.only, name):
            rows.append(find_pieces(data / name, parts))
            print(rows[-1], flush=True)
    title = "Pieces of meshes: their parts, and the shreds beside them, by area of the largest"
    command = "HPCAPP_DATA=DIR benchmarks/pieces.py"
    write_table(asked.output / "decisions-pieces.json", title, COLUMNS, rows, command)


if __name__ == "__main__":
    main()
