"""Our command beside screened Poisson: python benchmarks/peers.py FOLDER [CLOUD ...].

Every contender is a process of its own, started in turn in one run; CPU (user + sys), wall and
peak memory are those of the whole process with its children, as the kernel counts them. Results
of the peers are kept in FOLDER and used again (``--fresh`` measures them anew, interleaved with
ours: what a published figure needs).
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from clouds import Cloud, find_clouds, open_truth
from peer_table import print_cloud, print_summary

from hpcapp.applications.compare.metrics import as_json, measure_mesh
from hpcapp.applications.compare.truth import Truth
from hpcapp.io import read_mesh

__all__ = ["Contender", "Outcome", "Usage", "measure_process", "run_contender"]

OURS = "ours"
DEFAULT_PEERS = ("open3d:7", "open3d:8", "open3d:9")


@dataclass(frozen=True, slots=True)
class Usage:
    """What a process took.

    Parameters
    ----------
    exit_code : int
        Negative: the signal that ended it.
    cpu_s, wall_s : float
        Seconds; CPU is user + sys.
    rss_mb : float
        Largest resident set, in 10^6 bytes.
    """

    exit_code: int
    cpu_s: float
    wall_s: float
    rss_mb: float


@dataclass(frozen=True, slots=True)
class Contender:
    """A program that turns a cloud into a mesh.

    Parameters
    ----------
    command : list of str
        With ``{input}`` and ``{output}`` where the files go.
    """

    name: str
    command: list[str]

    def fill(self, source: Path, target: Path) -> list[str]:
        """Return the command with its files."""
        return [part.format(input=source, output=target) for part in self.command]


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a contender did on a cloud; `measures` is None where it made no mesh."""

    cloud: str
    contender: str
    usage: Usage
    measures: dict[str, Any] | None


def measure_process(command: list[str], log: Path) -> Usage:
    """Run a command to its end and return what it took.

    Parameters
    ----------
    log : Path
        Where its output goes.

    Returns
    -------
    Usage
        Of the process and of those of its children that it waited for.
    """
    helper = str(Path(__file__).with_name("process_usage.py"))
    found = subprocess.run(
        [sys.executable, "-I", "-S", helper, str(log), *command],
        check=True,
        capture_output=True,
        text=True,
    )
    return Usage(**json.loads(found.stdout))


def run_contender(
    contender: Contender, cloud: str, source: Path, truth: Truth, folder: Path, samples: int
) -> Outcome:
    """Run one contender on one cloud and measure its mesh.

    Parameters
    ----------
    cloud : str
        The cloud's name.
    source : Path
        Its points.
    folder : Path
        Where mesh, log and outcome are kept.
    samples : int
        Points on either surface for the distances.
    """
    stem = _stem(folder, cloud, contender)
    target = stem.with_suffix(".ply")
    target.unlink(missing_ok=True)
    usage = measure_process(contender.fill(source, target), stem.with_suffix(".log"))
    measures = None
    if usage.exit_code == 0 and target.exists():
        mesh = read_mesh(target)
        mesh = replace(mesh, vertices=mesh.vertices + mesh.origin, origin=np.zeros(3))
        measures = as_json(measure_mesh(mesh, truth, samples)) if len(mesh.faces) else None
    outcome = Outcome(cloud, contender.name, usage, measures)
    stem.with_suffix(".json").write_text(json.dumps(asdict(outcome)))
    return outcome


def run_all(
    clouds: list[Cloud],
    contenders: list[Contender],
    folder: Path,
    fresh: bool = False,
    repeats: int = 1,
    samples: int = 50_000,
) -> Iterator[list[Outcome]]:
    """Yield each cloud's outcomes, ours first; of repeated runs the one with the median CPU."""
    for cloud in clouds:
        source, truth = cloud.place(folder / "clouds"), open_truth(cloud)
        rounds: list[list[Outcome]] = []
        for _ in range(repeats):
            outcomes = []
            for contender in contenders:
                known = None if fresh else _recall(folder, cloud.name, contender)
                outcomes.append(
                    known or run_contender(contender, cloud.name, source, truth, folder, samples)
                )
            rounds.append(outcomes)
        yield [
            sorted(runs, key=lambda o: o.usage.cpu_s)[len(runs) // 2]
            for runs in zip(*rounds, strict=True)
        ]


def _recall(folder: Path, cloud: str, contender: Contender) -> Outcome | None:
    """Return a peer's kept outcome; ours is always measured anew."""
    path = _stem(folder, cloud, contender).with_suffix(".json")
    if contender.name == OURS or not path.exists():
        return None
    kept = json.loads(path.read_text())
    return Outcome(kept["cloud"], kept["contender"], Usage(**kept["usage"]), kept["measures"])


def _stem(folder: Path, cloud: str, contender: Contender) -> Path:
    """Return where a contender's files for a cloud go, less the suffix."""
    place = folder / "meshes" / cloud
    place.mkdir(parents=True, exist_ok=True)
    return place / contender.name.replace(":", "-")


def _contenders(ours: str, peers: list[str], python: str) -> list[Contender]:
    """Return our command and the peers, each of which is `peer_methods.py` in its own process."""
    script = str(Path(__file__).with_name("peer_methods.py"))
    return [
        Contender(OURS, shlex.split(ours)),
        *(Contender(name, [python, script, name, "{input}", "{output}"]) for name in peers),
    ]


def main() -> None:
    """Run the comparison and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where clouds, meshes and outcomes are kept")
    parser.add_argument("clouds", nargs="*", help="clouds or groups (clouds.py); all by default")
    parser.add_argument("--ours", default="hpcapp reconstruct {input} -o {output} --grid 256")
    parser.add_argument(
        "--peers",
        nargs="*",
        default=list(DEFAULT_PEERS),
        help="open3d, pymeshlab or pypoisson2, as open3d:DEPTH",
    )
    parser.add_argument("--peer-python", default=sys.executable, help="the interpreter with them")
    parser.add_argument("--fresh", action="store_true", help="measure the peers anew")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--samples", type=int, default=50_000, help="points for the distances")
    parser.add_argument("--json", type=Path, help="write every outcome to this file")
    args = parser.parse_args()
    contenders = _contenders(args.ours, args.peers, args.peer_python)
    everything: list[list[dict[str, Any]]] = []
    for outcomes in run_all(
        find_clouds(args.clouds), contenders, args.folder, args.fresh, args.repeats, args.samples
    ):
        everything.append([asdict(outcome) for outcome in outcomes])
        print_cloud(everything[-1], with_head=len(everything) == 1)
    print_summary(everything)
    if args.json:
        args.json.write_text(json.dumps(everything))


if __name__ == "__main__":
    main()
