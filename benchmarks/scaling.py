"""What machines bring, on emulated equal machines: scaling.py FOLDER [CLOUD] as root.

Each machine is held by a CPU quota: `CORES` of a core each, the master's machine too. The same job
runs on one such machine (``--backend serial``, one thread) and with workers on several, in one run
of this script. Variants:

=======  ==========================================================================
shared   workers read their tiles from a folder and write their parts there
fed      no folder: points come from the master's memory, parts go back there
links    ``fed``, every machine's cable held to 100 Mbit
slow     ``shared``, one machine four times slower: equal batches, and adaptive ones
cores    two workers on the two cores here, no quota; one process with one thread,
         and the default, beside it
paper    the paper's method, ``fed``
=======  ==========================================================================

Every mesh of the default method must be the serial one, byte for byte. FOLDER receives
``scaling.json``; a table goes to the standard output, and to the file of ``-o``.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from big_cloud import write_cloud
from emulated_machines import (
    ONE_THREAD,
    PERIOD_US,
    CpuGroup,
    missing_quotas,
    open_group,
    open_machines,
)
from tables import Row, parser_of, write_table

CORES = {4: 0.2, 8: 0.2, 16: 0.1}
SLOWER = 4.0
LINK_MBIT = 100.0
VARIANTS = ("shared", "fed", "links", "slow", "cores", "paper")
LIMIT_S = 1800.0
PAPER_GRID = 256  # it holds every node of a cube


@dataclass(frozen=True, slots=True)
class Run:
    """One job: without machines in one process; with the load here before, and a hash of the mesh.

    Wall time is that of the master's process, and within it CPU is that of each machine.
    """

    variant: str
    machines: int
    cores: float | None
    wall_s: float
    head_cpu_s: float
    worker_cpu_s: list[float]
    load: float
    mesh: str
    report: dict[str, Any] = field(repr=False)

    @property
    def cpu_s(self) -> float:
        """CPU seconds of all machines."""
        return self.head_cpu_s + sum(self.worker_cpu_s)


class Bench:
    """Runs one cloud's job on emulated machines; jobs with workers get the options."""

    def __init__(self, folder: Path, cloud: Path, options: Sequence[str]) -> None:
        self._folder = folder
        self._data = folder / "data"  # what machines share, or only the master sees
        self._data.mkdir(parents=True, exist_ok=True)
        inside = self._data / cloud.name
        if inside.resolve() != cloud.resolve():
            shutil.copyfile(cloud, inside)
        self._cloud = inside
        self._options = list(options)
        self._numbers = itertools.count()

    def alone(self, variant: str, cores: float | None, *options: str, threads: int = 1) -> Run:
        """Run the job in one process, with no more threads than asked for."""
        # The kernels take as many threads as there are cores that they may run on.
        pin = ["taskset", "-c", "0"] if threads == 1 else []
        with open_group(f"hpcapp-{os.getpid()}-alone-{next(self._numbers)}", cores) as group:
            prefix = [*group.prefix, *pin]
            return self._run(variant, 0, cores, group, [], prefix, options)

    def local(self, variant: str, workers: int, *options: str) -> Run:
        """Run the job with workers on this machine, held by nothing."""
        with open_group(f"hpcapp-{os.getpid()}-local", None) as group:
            words = ("--backend", "zmq", "--workers", str(workers), *self._options, *options)
            return self._run(variant, workers, None, group, [], group.prefix, words)

    def spread(
        self,
        variant: str,
        cores: Sequence[float],
        *options: str,
        shared: bool,
        link_mbit: float | None = None,
    ) -> Run:
        """Run the job on emulated machines; the master's has the first worker's quota."""
        place = self._folder / f"machines-{os.getpid()}-{next(self._numbers)}"
        hidden = None if shared else self._data
        with open_machines(place, cores, cores[0], hidden, link_mbit) as machines:
            words = ["--cluster", str(machines.inventory), "--backend", "zmq"]
            words += [*self._options, *options]
            return self._run(
                variant, len(cores), cores[0], machines.head_group, machines.groups,
                machines.head, words, shared,
            )  # fmt: skip

    def _run(
        self,
        variant: str,
        count: int,
        cores: float | None,
        head: CpuGroup,
        workers: Sequence[CpuGroup],
        prefix: Sequence[str],
        options: Sequence[str],
        is_shared: bool = False,
    ) -> Run:
        place, load = self._data / f"run-{os.getpid()}-{next(self._numbers)}", os.getloadavg()[0]
        mesh, scratch = place / "mesh.ply", place / "tmp"
        scratch.mkdir(parents=True)
        words = [sys.executable, "-P", "-m", "hpcapp", "reconstruct"]
        words += [str(self._cloud), "-o", str(mesh), "--json", *options]
        if is_shared:
            words += ["--temp-dir", str(place / "shared")]
        environment = os.environ | ONE_THREAD | {"TMPDIR": str(scratch)}
        before, began = [group.used_s() for group in (head, *workers)], time.perf_counter()
        done = subprocess.run(
            [*prefix, *words], env=environment, capture_output=True, text=True, timeout=LIMIT_S
        )
        wall = time.perf_counter() - began
        used = [group.used_s() - then for group, then in zip((head, *workers), before, strict=True)]
        if done.returncode:
            raise RuntimeError(f"{' '.join(words)}: exit code {done.returncode}\n{done.stderr}")
        with mesh.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()[:16]
        report = json.loads(done.stdout)
        shutil.rmtree(place)
        return Run(variant, count, cores, wall, used[0], used[1:], load, digest, report)


def plan_runs(
    bench: Bench, counts: Sequence[int], variants: Sequence[str], grid: int, rounds: int
) -> Iterator[Callable[[], Run]]:
    """Yield the runs, each after the one that it is compared with."""
    ours = ("--grid", str(grid))
    quotas = {count: CORES[count] for count in sorted(counts)}
    if {"shared", "fed", "links", "slow"}.intersection(variants):
        alone = partial(bench.alone, "serial")
        bases = [
            partial(alone, cores, "--backend", "serial", *ours)
            for cores in dict.fromkeys(quotas.values())
        ]
        yield from _begin_together(bases)  # their quotas leave cores idle
    equal = {count: [cores] * count for count, cores in quotas.items()}
    for count in quotas if "shared" in variants else ():
        yield partial(bench.spread, "shared", equal[count], *ours, shared=True)
    if "slow" in variants:
        count = 8 if 8 in quotas else min(quotas)
        uneven = [*equal[count][1:], quotas[count] / SLOWER]
        for policy in ("equal", "adaptive"):
            words = (*ours, "--policy", policy)
            yield partial(bench.spread, f"slow, {policy}", uneven, *words, shared=True)
    for count in quotas if "fed" in variants else ():
        yield partial(bench.spread, "fed", equal[count], *ours, shared=False)
    for count in quotas if "links" in variants else ():
        run = partial(bench.spread, "links", equal[count], *ours, shared=False)
        yield partial(run, link_mbit=LINK_MBIT)
    for _ in range(rounds if "cores" in variants else 0):
        yield partial(bench.alone, "serial", None, "--backend", "serial", *ours)
        yield partial(bench.local, "cores", 2, *ours)
        yield partial(bench.alone, "cores, default", None, *ours, threads=2)
    if "paper" in variants:
        theirs = ("--method", "paper", "--grid", str(min(grid, PAPER_GRID)))
        first = min(quotas)
        yield partial(bench.alone, "paper, serial", quotas[first], "--backend", "serial", *theirs)
        for count in (count for count, quota in quotas.items() if quota == quotas[first]):
            yield partial(bench.spread, "paper", [quotas[first]] * count, *theirs, shared=False)


def _begin_together(runs: Sequence[Callable[[], Run]]) -> Iterator[Callable[[], Run]]:
    """Yield runs that are under way, all at once, as soon as the first is asked for."""
    with ThreadPoolExecutor(max(1, len(runs))) as pool:
        for future in [pool.submit(run) for run in runs]:
            yield future.result


def find_base(runs: Sequence[Run], run: Run) -> Run:
    """Return the run of one process that another is compared with: the last one before it."""
    name = "paper, serial" if run.variant.startswith("paper") else "serial"
    before = runs[: runs.index(run) + 1]
    return [base for base in before if (base.variant, base.cores) == (name, run.cores)][-1]


def check_mesh(runs: Sequence[Run]) -> None:
    """Raise AssertionError where the default method's meshes are not all the same."""
    meshes = {run.mesh for run in runs if not run.variant.startswith("paper")}
    assert len(meshes) < 2, f"the meshes differ: {[(run.variant, run.mesh) for run in runs]}"


COLUMNS = ("variant", "machines", "core each", "wall s", "speed-up", "CPU s: head", "a worker",
           "all", "all, by serial's", "tiles", "MB sent, received", "load")  # fmt: skip


def tabulate(runs: Sequence[Run]) -> list[Row]:
    """Return one row for each run."""
    rows: list[Row] = []
    for run in runs:
        base, report, used = find_base(runs, run), run.report, run.worker_cpu_s
        rows.append([
            run.variant,
            str(run.machines or 1),
            "-" if run.cores is None else f"{run.cores:g}",
            f"{run.wall_s:.1f}",
            f"{base.wall_s / run.wall_s:.2f}",
            f"{run.head_cpu_s:.1f}",
            f"{min(used):.1f} to {max(used):.1f}" if used else "-",
            f"{run.cpu_s:.1f}",
            f"{run.cpu_s / base.cpu_s:.2f}",
            str(report.get("tiles", "-")),
            f"{report['bytes_sent'] / 1e6:.0f}, {report['bytes_received'] / 1e6:.0f}",
            f"{run.load:.1f}",
        ])  # fmt: skip
    return rows


def main() -> None:
    """Measure, print the table, and write all that was found."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="receives results; needs room for the points")
    parser.add_argument("cloud", type=Path, nargs="?", help="by default a sphere with bumps")
    parser.add_argument("--points", type=int, default=10_000_000, help="of that sphere")
    parser.add_argument("--grid", type=int, default=1024)
    parser.add_argument("--machines", type=int, nargs="+", choices=CORES, default=list(CORES))
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--rounds", type=int, default=3, help="of the variant `cores`")
    parser.add_argument("--options", default="", help="more for jobs with workers, in one word")
    asked = parser.parse_args()
    if reason := missing_quotas():
        sys.exit(reason)
    folder = asked.folder.resolve()
    data = folder / "data"
    data.mkdir(parents=True, exist_ok=True)
    cloud = asked.cloud
    if cloud is None:
        cloud = data / f"bumps-{asked.points}.ply"
        if not cloud.exists():
            write_cloud(cloud, asked.points)
    bench = Bench(folder, cloud, asked.options.split())
    runs: list[Run] = []
    for run in plan_runs(bench, asked.machines, asked.variants, asked.grid, asked.rounds):
        runs.append(run())
        print(f"{runs[-1]}", file=sys.stderr, flush=True)
        results = {
            "cloud": cloud.name, "grid": asked.grid, "period_us": PERIOD_US,
            "cores": os.cpu_count(), "runs": [asdict(done) for done in runs],
        }  # fmt: skip
        (folder / "scaling.json").write_text(json.dumps(results, indent=2) + "\n")
        check_mesh(runs)
    rows = tabulate(runs)
    print(*(f"| {' | '.join(map(str, row))} |" for row in (COLUMNS, *rows)), sep="\n")
    title = f"Emulated machines: {asked.points:,} points, grid {asked.grid}"
    notes = ["A machine has so much of a core. `serial` is one of them with one thread."]
    write_table(asked.output, title, COLUMNS, rows, notes)


if __name__ == "__main__":
    main()
