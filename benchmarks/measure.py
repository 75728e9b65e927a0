#!/usr/bin/env python3
"""Measure the figures that README and docs quote.

    benchmarks/measure.py [--list] [--all] [--folder DIR] [NAME ...]

Measured are the results that are missing, or older than a hundred commits: one after the other,
each by a script of its own, into ``results/NAME.json``. A result is written when it is whole: a run
that was killed goes on with the next one. ``--all`` measures all that are not of this build, and
a NAME what it names. Scans are those of the folder that HPCAPP_DATA names; where something else
that a result needs is missing, a line says so and the result stays as it is.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from tables import BUILD, RESULTS, ask_git, count_age, find_build

OLD = 100
"""Commits after which a figure is measured again."""
DATA, ROOT_USER = "HPCAPP_DATA", "root"
RAYS = (DATA, "trimesh", "embreex")
PEERS = (DATA, "open3d")


@dataclass(frozen=True, slots=True)
class Result:
    """A table that is quoted: what makes it, what that needs, and minutes of two idle cores."""

    name: str
    command: str
    needs: tuple[str, ...]
    minutes: int

    @property
    def path(self) -> Path:
        """Where the table is."""
        return RESULTS / f"{self.name}.json"

    def read_commit(self) -> str | None:
        """Return the commit that was measured; None where there is no table."""
        if not self.path.is_file():
            return None
        commit: str = json.loads(self.path.read_text(encoding="utf-8"))["commit"]
        return commit

    def find_missing(self) -> list[str]:
        """Return which needs this machine does not meet."""
        met = {DATA: Path(os.environ.get(DATA, "-")).is_dir(), ROOT_USER: os.geteuid() == 0}
        return [need for need in self.needs
                if not (met[need] if need in met else find_spec(need))]  # fmt: skip


SEEDS = "59001,59002,59003,59004"
TABLE = (
    Result("alignment", "alignment.py", (*RAYS, "kiss_matcher"), 10),
    Result("closing", "closing.py --folders raw", RAYS, 20),
    Result("communicator", "communicator.py --rounds 3", ("distributed", "cryptography"), 5),
    Result("cost", "peers.py cost --repeats 3", PEERS, 3),
    Result("decisions-handles", "decisions.py handles", (DATA,), 8),
    Result("decisions-lines", "decisions.py lines", (DATA,), 3),
    Result("decisions-normals", "decisions.py normals", (DATA,), 5),
    Result("decisions-pieces", "decisions.py pieces", (DATA,), 3),
    Result("decisions-registration", "decisions.py registration", (), 1),
    Result("ground", "ground.py", (DATA, "CSF"), 4),
    Result("heaps", "volumes.py --pairs 0 --grounds 0 --piles 0 --heaps 80 --seed 20000", (), 3),
    Result("large-job", "large_job.py 20_000_000 -- --max-memory 1G", (), 8),
    Result(
        "machines",
        "scaling.py . --points 2_500_000 --grid 512 --machines 4 --variants shared slow",
        (ROOT_USER,),
        5,
    ),
    Result("moving", "moving.py", RAYS, 5),
    Result("photographs", "photographs.py", ("xatlas",), 2),
    Result("readings", f"readings.py --seeds {SEEDS} --count 6 --folders raw", RAYS, 60),
    Result("scans", "peers.py scans", (*PEERS, "pymeshlab", "poisson"), 40),
    Result("simplification", "simplification.py", PEERS, 3),
    Result("update", "updates.py . --points 600_000", (), 3),
    Result("worlds-ci", "worlds.py", RAYS, 12),
)


def describe(result: Result, build: str) -> str:
    """Return a line: the age of a result, what makes it, and what that needs."""
    commit = result.read_commit()
    age = None if commit is None else count_age(commit)
    if commit in (None, build):
        told = "this build" if commit else "missing"
    else:
        told = "no such commit" if age is None else f"{age} commits{', old' * (age > OLD)}"
    needs = f"  ({', '.join(result.needs)})" if result.needs else ""
    return f"{result.name:24}{told:20}{result.minutes:4} min  {result.command}{needs}"


def is_due(result: Result) -> bool:
    """Tell whether a result is missing, of no known commit, or old."""
    commit = result.read_commit()
    age = None if commit is None else count_age(commit)
    return age is None or age > OLD


def choose(names: list[str], build: str, *, takes_all: bool) -> list[Result]:
    """Return what is to be measured."""
    if unknown := set(names) - {result.name for result in TABLE}:
        sys.exit(f"no result is called {', '.join(sorted(unknown))}: --list tells what there is")
    if names:
        return [result for result in TABLE if result.name in names]
    if takes_all:
        return [result for result in TABLE if result.read_commit() != build]
    return [result for result in TABLE if is_due(result)]


def measure(result: Result, folder: Path) -> bool:
    """Measure one result, in a folder of its own, and tell whether it is there."""
    if missing := result.find_missing():
        print(f"{result.name}: left as it is, for want of {', '.join(missing)}", flush=True)
        return False
    script, *words = shlex.split(result.command)
    at = words.index("--") if "--" in words else len(words)
    words[at:at] = ["-o", str(result.path)]
    place = folder / result.name
    place.mkdir(parents=True, exist_ok=True)
    print(f"{result.name}: about {result.minutes} minutes", flush=True)
    began = time.perf_counter()
    with (place / "log").open("w", encoding="utf-8") as log:
        ended = subprocess.run(
            [sys.executable, str(Path(__file__).with_name(script)), *words],
            cwd=place, stdout=log, stderr=subprocess.STDOUT, check=False,
        )  # fmt: skip
    took = (time.perf_counter() - began) / 60.0
    said = "measured" if not ended.returncode else f"failed, {place / 'log'} says how"
    print(f"{result.name}: {said}, {took:.1f} minutes", flush=True)
    return not ended.returncode


def main() -> int:
    """List, or measure what is due; 1 where something could not be measured."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--list", action="store_true", help="tell the age of each result")
    parser.add_argument("--all", action="store_true", help="all that are not of this build")
    parser.add_argument("--folder", type=Path, default=RESULTS.parent / "scratch",
                        help="clouds, meshes and logs; kept  [default: %(default)s]")  # fmt: skip
    asked = parser.parse_args()
    build = find_build()
    if build is None:
        sys.exit("no history of git is here: a figure would have no commit")
    chosen = choose(asked.names, build, takes_all=asked.all)
    if asked.list:
        print("\n".join(describe(result, build) for result in TABLE))
        return 0
    if changed := ask_git("status", "--porcelain", "--", *BUILD):
        sys.exit(f"not of any commit: {changed.splitlines()[0].split()[-1]}; commit it first")
    done = [measure(result, asked.folder.resolve()) for result in chosen]
    return 0 if all(done) else 1


if __name__ == "__main__":
    sys.exit(main())
