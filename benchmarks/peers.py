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
from statistics import geometric_mean
from typing import Any

import numpy as np
from clouds import Cloud, find_clouds, open_truth

from hpcapp.applications.compare.metrics import as_json, measure_mesh
from hpcapp.applications.compare.truth import Truth
from hpcapp.io import read_mesh

OURS = "ours"
DEFAULT_PEERS = ("open3d:7", "open3d:8", "open3d:9")
_HEAD = (
    f"{'cloud':20} {'contender':12} {'L1 %':>8} {'ratio':>6} {'rms %':>8} {'Hausd %':>8} "
    f"{'normal':>7} {'closed':>6} {'comps':>5} {'genus':>5} {'CPU s':>7} {'wall s':>7} {'MB':>6}"
)


@dataclass(frozen=True, slots=True)
class Usage:
    """What a process took: user + sys, and the largest resident set, in 10^6 bytes.

    A negative exit code is the signal that ended it.
    """

    exit_code: int
    cpu_s: float
    wall_s: float
    rss_mb: float


@dataclass(frozen=True, slots=True)
class Contender:
    """A program that turns a cloud into a mesh: ``{input}`` and ``{output}`` are the files."""

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
    """Run a command to its end, with its output in a log, and return what it took.

    Counted are the process and those of its children that it waited for.
    """
    helper = str(Path(__file__).with_name("process_usage.py"))
    done = subprocess.run(
        [sys.executable, "-I", "-S", helper, str(log), *command],
        check=True,
        capture_output=True,
        text=True,
    )
    return Usage(**json.loads(done.stdout))


def run_contender(
    contender: Contender, cloud: str, source: Path, truth: Truth, folder: Path, samples: int
) -> Outcome:
    """Run one contender on one cloud, and measure its mesh by so many points on either surface.

    Mesh, log and outcome are kept in the folder.
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


def print_cloud(outcomes: list[Outcome], with_head: bool) -> None:
    """Print one cloud's contenders; `ratio` is our L1 by theirs."""
    if with_head:
        print(_HEAD)
    ours = outcomes[0]
    for outcome in outcomes:
        start = f"{outcome.cloud:20} {outcome.contender:12}"
        usage, measures = outcome.usage, outcome.measures
        if measures is None:
            print(f"{start} no mesh, exit code {usage.exit_code}", flush=True)
            continue
        ratio = _ratio(ours, outcome, "l1")
        shape = measures["topology"]
        print(
            f"{start} {measures['l1']:8.4f} {'' if ratio is None else f'{ratio:.3f}':>6} "
            f"{measures['rms']:8.4f} {measures['hausdorff']:8.3f} {measures['normal_deg']:7.2f} "
            f"{'yes' if shape['watertight'] else 'NO':>6} {shape['components']:5} "
            f"{'-' if shape['genus'] is None else shape['genus']:>5} {usage.cpu_s:7.2f} "
            f"{usage.wall_s:7.2f} {usage.rss_mb:6.0f}",
            flush=True,
        )


def print_summary(clouds: list[list[Outcome]]) -> None:
    """Print geometric means of ours by each peer's, and by the best peer of each cloud."""
    if not clouds:
        return
    rivals = [outcome.contender for outcome in clouds[0][1:]]
    print(f"\nours / theirs over {len(clouds)} clouds, geometric mean (worst)")
    for rival in (*rivals, "best of them"):
        parts = []
        for key in ("l1", "normal_deg", "cpu_s", "wall_s", "rss_mb"):
            values = ratios(clouds, rival, key)
            if values:
                parts.append(f"{key} {geometric_mean(values):.3f} ({max(values):.3f})")
        print(f"  {rival:14} " + "  ".join(parts))


def ratios(clouds: list[list[Outcome]], rival: str, key: str) -> list[float]:
    """Return ours by theirs for every cloud on which both made a mesh.

    Parameters
    ----------
    rival : str
        A contender, or ``best of them``: whoever has the smallest value on that cloud.
    key : str
        ``l1``, ``normal_deg``, ``cpu_s``, ``wall_s`` or ``rss_mb``.
    """
    worst = []
    for ours, *theirs in clouds:
        named = [o for o in theirs if rival in (o.contender, "best of them")]
        values = [r for r in (_ratio(ours, o, key) for o in named) if r is not None]
        if values:
            worst.append(max(values))
    return worst


def _ratio(ours: Outcome, theirs: Outcome, key: str) -> float | None:
    """Return ours by theirs; None where either made no mesh or theirs is zero."""
    if ours is theirs or ours.measures is None or theirs.measures is None:
        return None
    ours_value, their_value = (
        float(o.measures[key] if o.measures and key in o.measures else getattr(o.usage, key))
        for o in (ours, theirs)
    )
    return ours_value / their_value if ours_value > 0.0 < their_value else None


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
    clouds: list[list[Outcome]] = []
    for outcomes in run_all(
        find_clouds(args.clouds), contenders, args.folder, args.fresh, args.repeats, args.samples
    ):
        clouds.append(outcomes)
        print_cloud(outcomes, with_head=len(clouds) == 1)
    print_summary(clouds)
    if args.json:
        args.json.write_text(
            json.dumps([[asdict(outcome) for outcome in outcomes] for outcomes in clouds])
        )


if __name__ == "__main__":
    main()
