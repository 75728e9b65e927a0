"""Make a large cloud into a mesh, killed once in the middle: large_job.py POINTS FOLDER.

::

    cloud (see `big_cloud`) ── hpcapp reconstruct --resume ── SIGKILL ── the same command ──> mesh
                                  memory and disk are looked at every second

FOLDER, by default this one, gets the cloud, if it is not there yet, the temporary folder and the
mesh. What follows ``--`` is given to `hpcapp reconstruct`
in place of ``--max-memory 4G``.

Memory is that of all processes of the job without the files that they map, which the system can
take back. CPU time is what they had taken when they were last looked at.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from big_cloud import measure_distances, write_cloud
from tables import parser_of, write_table

from hpcapp.io import open_points

RATIO = 1000.0
OPTIONS = ("--max-memory", "4G")
POLL_S = 1.0
_HELD = re.compile(r"^Pss_(?:Anon|Shmem): +([0-9]+) kB$", re.MULTILINE)
_ADVANCE = re.compile(r"extract: (\d+) of (\d+)")


@dataclass(slots=True)
class Usage:
    """What a run took: seconds, and bytes at most."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    memory: int = 0
    disk: int = 0
    mesh: int = 0
    exit_code: int = 0
    last_line: str = ""


def count_disk(paths: Iterable[Path]) -> int:
    """Return how many bytes of disk some files and folders take."""
    total = 0
    for path in paths:
        for file in [path, *path.rglob("*")]:
            with suppress(OSError):  # it is gone already
                total += 512 * os.lstat(file).st_blocks
    return total


def look_at(process: int) -> tuple[int, float]:
    """Return the bytes and CPU seconds of a process, its children, and those that have ended.

    Mapped files are not counted, and what several processes share is counted once.
    """
    parents, times = {}, {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended
            fields = file.read_text().rpartition(")")[2].split()
            number = int(file.parent.name)
            parents[number] = int(fields[1])
            times[number] = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")

    def belongs(number: int) -> bool:
        while number in parents and number != process:
            number = parents[number]
        return number == process

    memory, cpu_s = 0, 0.0
    for number in filter(belongs, parents):
        cpu_s += times[number]
        with suppress(OSError):
            held = Path(f"/proc/{number}/smaps_rollup").read_text()
            memory += 1024 * sum(map(int, _HELD.findall(held)))
    return memory, cpu_s


def run(command: Sequence[str], temp: Path, mesh: Path, *, is_killed: bool) -> Usage:
    """Run a job, until half of its tiles are done or to the end, and return what it took."""
    used, is_over = Usage(), threading.Event()
    began = time.perf_counter()
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None

    def look() -> None:
        memory, cpu_s = look_at(process.pid)
        used.memory, used.cpu_s = max(used.memory, memory), max(used.cpu_s, cpu_s)
        used.disk = max(used.disk, count_disk([temp]))
        beside = mesh.parent.glob(f".*{mesh.name}*")  # as it is written
        used.mesh = max(used.mesh, count_disk([*beside, *mesh.parent.glob(mesh.name)]))

    def watch() -> None:
        while not is_over.wait(POLL_S):
            look()

    watcher = threading.Thread(target=watch)
    watcher.start()
    for line in process.stderr:
        print(line, end="", file=sys.stderr, flush=True)
        used.last_line = line.strip()
        found = _ADVANCE.search(line)
        if is_killed and found and 2 * int(found[1]) >= int(found[2]):
            look()
            process.kill()
    used.exit_code = process.wait()
    is_over.set()
    watcher.join()
    process.stderr.close()
    used.wall_s = time.perf_counter() - began
    return used


def main() -> None:
    """Run the job, and write what it took."""
    parser = parser_of(__doc__)
    parser.add_argument("points", type=int)
    parser.add_argument("--folder", type=Path, default=Path())
    parser.add_argument("--uneven", type=float, default=RATIO, metavar="RATIO")
    at = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    asked = parser.parse_args(sys.argv[1:at])
    asked.folder.mkdir(parents=True, exist_ok=True)
    cloud, mesh, temp = (asked.folder / name for name in ("cloud.ply", "mesh.ply", "temp"))
    if not cloud.exists() or open_points(cloud).count != asked.points:
        began = time.perf_counter()
        begun = cloud.with_suffix(".part")
        write_cloud(begun, asked.points, ratio=asked.uneven)
        begun.rename(cloud)
        print(f"cloud: {time.perf_counter() - began:.0f} s", file=sys.stderr)
    options = sys.argv[at + 1 :] or [*OPTIONS]
    job = ["reconstruct", str(cloud), "-o", str(mesh), "--temp-dir", str(temp), "--resume"]
    command = [sys.executable, "-m", "hpcapp", *job, *options]
    killed = run(command, temp, mesh, is_killed=True)
    if killed.exit_code != -9:
        sys.exit(f"exit code {killed.exit_code}, not killed: ask for more points, or less memory")
    resumed = run(command, temp, mesh, is_killed=False)
    if resumed.exit_code:
        sys.exit(f"exit code {resumed.exit_code} when it went on")
    vertices, rms, largest = measure_distances(mesh)
    notes = [
        f"The cloud takes {cloud.stat().st_size / 1e9:.1f} GB, {asked.uneven:g}:1 in density.",
        resumed.last_line.replace(str(mesh), "The mesh"),
        f"{vertices:,} vertices, off the formula by {rms:.2g} (rms), {largest:.2g} at most.",
    ]
    runs = (killed, resumed)
    rows = [
        ["wall, s", *(f"{run.wall_s:,.0f}" for run in runs)],
        ["CPU, s", *(f"{run.cpu_s:,.0f}" for run in runs)],
        ["memory at most, GB", *(f"{run.memory / 1e9:.2f}" for run in runs)],
        ["temporary folder at most, GB", *(f"{run.disk / 1e9:.2f}" for run in runs)],
        ["the same, bytes a point", *(f"{run.disk / asked.points:.1f}" for run in runs)],
        ["mesh, GB", *(f"{run.mesh / 1e9:.2f}" for run in runs)],
    ]
    title = f"{asked.points:,} points, killed when half of the tiles were done"
    print(*rows, *notes, sep="\n")
    write_table(asked.output, title, ["", "until it was killed", "with --resume"], rows, notes)


if __name__ == "__main__":
    main()
