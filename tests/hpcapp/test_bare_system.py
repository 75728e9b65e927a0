"""What Windows lacks is taken away: work of one machine goes on, the rest is refused in words."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bare_system
import pytest

VERBS = (
    "simulate --shape knot --points 600 -o points.ply",
    "info points.ply",
    "reconstruct points.ply -o mesh.ply --grid 32",
    "reconstruct points.ply -o threads.ply --grid 32 --backend threads --workers 2",
    "convert points.ply -o points.las",
    "convert points.las -o packed.laz",
    "mend mesh.ply -o mended.glb --fill-holes 3s --pieces 1",
    "simplify mesh.ply -o light.obj --faces 200",
    "compare mesh.ply points.ply",
    "view mesh.ply -o page.html --png picture.png --no-open",
)
REFUSED = (
    ("reconstruct points.ply -o no.ply --backend zmq", "--backend zmq cannot run on this system"),
    ("info packed.laz", "is decoded by a process that must be limited"),
    ("doctor cluster.yaml", "this needs fcntl, which this system has not"),
)


@pytest.mark.slow  # a process that imports all libraries
def test_one_machine_works_without_what_windows_lacks(tmp_path: Path) -> None:
    words = [*VERBS, *(words for words, _ in REFUSED)]
    done = subprocess.run(
        [sys.executable, bare_system.__file__, *words],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    codes = [int(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("code ")]
    assert codes == [0] * len(VERBS) + [2] * len(REFUSED), done.stderr
    for _, told in REFUSED:
        assert told in done.stderr
    assert (tmp_path / "mesh.ply").read_bytes() == (tmp_path / "threads.ply").read_bytes()
    assert "internal error" not in done.stderr
