"""What a folder costs in place of memory: places.py [--rounds N] CLOUD [RECONSTRUCT OPTIONS].

One job with its points in memory, and with its points in a folder (in TMPDIR: name a place in
memory, such as /dev/shm), turn by turn; the least CPU time and memory of each, and the ratios.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from process_usage import run

from hpcapp.applications.surface.input import room

PLACES = ("memory", "folder")


def reconstruct(place: str, arguments: list[str]) -> int:
    """Run ``hpcapp`` in this process with its points in one place, whatever pays."""
    from hpcapp.__main__ import main

    vars(room).update(
        fits_memory=lambda *_: place == "memory", may_pay_in_folder=lambda *_: place == "folder"
    )
    sys.argv = ["hpcapp", "reconstruct", *arguments]
    return main()


def compare(cloud: Path, rounds: int, options: list[str]) -> dict[str, list[float]]:
    """Return the least CPU seconds and megabytes of each place; the meshes are the same."""
    found: dict[str, list[tuple[float, float]]] = {place: [] for place in PLACES}
    meshes = set()
    with tempfile.TemporaryDirectory() as folder:
        mesh, log = Path(folder, "mesh.ply"), Path(folder, "log")
        for number in range(rounds):
            for place in PLACES if number % 2 == 0 else PLACES[::-1]:
                job = [sys.executable, __file__, "--place", place, str(cloud), "-o", str(mesh)]
                used = run(str(log), [*job, *options])
                text = log.read_text()
                if used["exit_code"] or ("points are put into" in text) != (place == "folder"):
                    raise SystemExit(text)
                found[place].append((used["cpu_s"], used["rss_mb"]))
                meshes.add(mesh.read_bytes())
    if len(meshes) > 1:
        raise SystemExit("the meshes differ")
    return {place: [min(column) for column in zip(*rows, strict=True)]
            for place, rows in found.items()}  # fmt: skip


def main() -> None:
    """Compare, and print a line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cloud", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("options", nargs=argparse.REMAINDER)
    asked = parser.parse_args()
    best = compare(asked.cloud, asked.rounds, asked.options)
    for place, (seconds, megabytes) in best.items():
        print(f"{place}: {seconds:.2f} CPU s, {megabytes:.0f} MB")
    time, memory = (b / a for a, b in zip(best["memory"], best["folder"], strict=True))
    print(f"folder over memory: CPU time {time:.2f}, memory {memory:.2f}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--place"]:
        sys.exit(reconstruct(sys.argv[2], sys.argv[3:]))
    main()
