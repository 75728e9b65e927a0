"""Our command beside screened Poisson: peers.py scans|cost|CLOUD ... [--folder DIR] [-o FILE].

Every contender is a process of its own, started in turn in one run; CPU (user + sys), wall and
peak memory are those of the whole process with its children, as the kernel counts them. Results
are kept in the folder, by default this one. Those of the peers are used again, and ours of the same
build; a run that measures costs (more than one of ``--repeats``) takes all anew.

``scans`` are those of real objects with known truth: errors by those of the best of Open3D's depths
7, 8 and 9, chosen scan by scan by the truth, and of PoissonRecon and MeshLab at depth 8. ``cost``
are three clouds at grid 256 beside Open3D at depth 8. Other names are those of `clouds.py`.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import geometric_mean
from typing import Any

import numpy as np
from clouds import Cloud, find_clouds, open_truth
from tables import Row, find_build, parser_of, write_table

from hpcapp.applications.compare.metrics import as_json, measure_mesh
from hpcapp.applications.compare.truth import Truth
from hpcapp.io import read_mesh

OURS = "ours"
OUR_COMMAND = "hpcapp reconstruct {input} -o {output} --backend serial"
BEST = "best of them"
DEFAULT_PEERS = ("open3d:7", "open3d:8", "open3d:9")
SCAN_PEERS = (*DEFAULT_PEERS, "pypoisson2:8", "pymeshlab:8")
COST_CLOUDS = ("bunny-36k", "bunny-263k", "torus-1M")
SCAN_COLUMNS = ("scan", "kind", "L1", *SCAN_PEERS, "by the best", "largest by depth 8",
                "pieces", "genus", "right topology", "CPU s")  # fmt: skip
COST_COLUMNS = ("cloud", "CPU s, ours", "Open3D", "Open3D by ours", "MB, ours", "Open3D")
OPEN = ("gargoyle__one_side",)
"""Scans that show a part of their truth: not in the means."""
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
    build: str | None = None


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
    outcome = Outcome(cloud, contender.name, usage, measures, find_build())
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
    """Return a kept outcome: of a peer, or of this build."""
    path = _stem(folder, cloud, contender).with_suffix(".json")
    if not path.exists():
        return None
    kept = json.loads(path.read_text())
    if contender.name == OURS and kept.get("build") != find_build():
        return None
    return Outcome(**kept | {"usage": Usage(**kept["usage"])})


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
    for rival in (*rivals, BEST):
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
        named = [o for o in theirs if rival in (o.contender, BEST)]
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


def tabulate_scans(clouds: list[list[Outcome]]) -> tuple[list[Row], list[str]]:
    """Return a row for each scan, and the geometric means."""
    told = json.loads(Path(os.environ["HPCAPP_DATA"], "tuning/manifest.json").read_text())["meshes"]
    rows: list[Row] = []
    for ours, *theirs in clouds:
        assert ours.measures is not None, ours.cloud
        mesh, shape = told[ours.cloud.split("__")[0]], ours.measures["topology"]
        l1 = [f"{one.measures['l1']:.4f}" if one.measures else "-" for one in (ours, *theirs)]
        is_right = shape["watertight"] and (shape["components"], shape["genus"]) == (
            mesh["components"], mesh["genus"],
        )  # fmt: skip
        largest = _ratio(
            ours, next(one for one in theirs if one.contender == "open3d:8"), "hausdorff"
        )
        rows.append([
            ours.cloud, mesh["kind"], *l1, round(max(ratios([[ours, *theirs[:3]]], BEST, "l1")), 3),
            round(largest or 0.0, 2), shape["components"], str(shape["genus"]),
            "yes" if is_right else "no", round(ours.usage.cpu_s, 2),
        ])  # fmt: skip
    closed = [cloud for cloud in clouds if cloud[0].cloud not in OPEN]
    right = sum(row[-2] == "yes" and row[0] not in OPEN for row in rows)
    notes = [f"Open3D's best depth: {_mean(closed, DEFAULT_PEERS)}; right topology in {right}."]
    for noise in ("low", "medium", "high"):
        some = [cloud for cloud in closed if cloud[0].cloud.endswith(f"__{noise}")]
        notes.append(f"{noise} noise: {_mean(some, DEFAULT_PEERS)}.")
    notes += [f"{peer}: {_mean(closed, (peer,))}." for peer in SCAN_PEERS[3:]]
    return rows, notes


def _mean(clouds: list[list[Outcome]], peers: Sequence[str]) -> str:
    """Return the geometric mean and the worst of our L1 by that of the best of some peers."""
    some = [[ours, *(one for one in theirs if one.contender in peers)] for ours, *theirs in clouds]
    found = ratios(some, BEST, "l1")
    return f"{geometric_mean(found):.3f}, worst {max(found):.2f}, over {len(found)} scans"


def tabulate_costs(clouds: list[list[Outcome]]) -> list[Row]:
    """Return a row for each cloud, of ours and one peer."""
    rows: list[Row] = []
    for ours, theirs in clouds:
        a, b = ours.usage, theirs.usage
        rows.append([ours.cloud, round(a.cpu_s, 2), round(b.cpu_s, 2), round(b.cpu_s / a.cpu_s, 1),
                     round(a.rss_mb), round(b.rss_mb)])  # fmt: skip
    return rows


def main() -> None:
    """Run the comparison, print it and write its table."""
    parser = parser_of(__doc__)
    parser.add_argument("clouds", nargs="*", help="scans, cost, or clouds and groups of clouds.py")
    parser.add_argument("--folder", type=Path, default=Path())
    parser.add_argument("--ours", default=OUR_COMMAND, help="with {input} and {output}")
    parser.add_argument(
        "--peers", nargs="*", help="open3d, pymeshlab or pypoisson2, as open3d:DEPTH"
    )
    parser.add_argument("--peer-python", default=sys.executable, help="the interpreter with them")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--samples", type=int, default=50_000, help="points for the distances")
    asked = parser.parse_args()
    is_cost, is_scans = asked.clouds == ["cost"], asked.clouds == ["scans"]
    standard = ["open3d:8"] if is_cost else SCAN_PEERS if is_scans else DEFAULT_PEERS
    ours = f"{asked.ours} --grid 256" if is_cost else asked.ours  # as fine as depth 8
    contenders = _contenders(ours, asked.peers or [*standard], asked.peer_python)
    chosen = find_clouds([*COST_CLOUDS] if is_cost else asked.clouds)
    clouds: list[list[Outcome]] = []
    for outcomes in run_all(
        chosen, contenders, asked.folder, asked.repeats > 1, asked.repeats, asked.samples
    ):
        clouds.append(outcomes)
        print_cloud(outcomes, with_head=len(clouds) == 1)
    print_summary(clouds)
    if is_cost:
        title = "Cost at grid 256 beside Open3D's screened Poisson at depth 8"
        notes = [f"Medians of {asked.repeats} runs, in which both take turns."]
        write_table(asked.output, title, COST_COLUMNS, tabulate_costs(clouds), notes)
    elif is_scans:
        title = "Scans of real objects with known truth: mean errors in per cent of the diagonal"
        write_table(asked.output, title, SCAN_COLUMNS, *tabulate_scans(clouds))


if __name__ == "__main__":
    main()
