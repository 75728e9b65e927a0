"""What each task of a job declares: the truth passes, and most lies do not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import recorded_tasks
from directions import random_directions
from lies import LIES
from little_memory import leave_little_memory
from recorded_tasks import Answer, RecordedTasks

from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpcapp.progress import Progress
from hpccomponent.errors import JobError, ProtocolError
from hpccomponent.protocol.codec import encode_values
from hpccomponent.protocol.declared import check_result
from hpccomponent.runtime.tasks import TaskRegistry
from hpccomponent.store.places import open_store

MOST_BYTES = 100 << 20  # that any answer of these jobs may have
MOST_ANSWERS = 10  # of each task, about which all lies are told

BELIEVED: dict[str, set[str]] = {
    "zero": set(),
    "plus one": {
        "bound_range",  # how many points are near
        "sum_region",  # sums of points by cell and facing, of which a step is next to nothing
        "sum_tile",  # how many finest cells a tile has, which is only reported
    },
    "times 1.001": {
        "bound_range",
        "bound_region",  # the box around what is left when some are dropped
        "group_region",  # where patches lie, and their noise
        "judge_support",  # where no point supports the surface
        "mesh_gap",
        "mesh_tile",
        "open_part",
        "survey_range",  # the box and the sample of a file, which nobody else has read
        "survey_support",
    },
    "permuted": {
        "fit_patches",  # which patch has which quadric
        "judge_support",  # in which order places are
    },
    "shifted": set(),
    "giant": set(),
}
"""The lies that cannot be told from the truth by what the master knows: they are of possible size,
and only another worker that does the same finds them out."""


class Looked:
    """Holds every answer, and every lie about it, against what its task declares."""

    def __init__(self) -> None:
        self.believed: dict[str, set[str]] = {lie: set() for lie in LIES}
        self.refused: list[str] = []
        self.limits: Counter[str] = Counter()
        self._asked: Counter[str] = Counter()

    def look(self, answer: Answer) -> None:
        name, truth = answer.name, encode(answer.value)
        self.limits[name] = max(self.limits[name], answer.limit_bytes)
        self.refused += find_refusals(answer)
        if len(truth) > answer.limit_bytes:
            self.refused.append(f"{name}: {len(truth)} bytes of {answer.limit_bytes}")
        self._asked[name] += 1
        if self._asked[name] > MOST_ANSWERS:
            return
        for lie, tell in LIES.items():
            value = tell(answer.value)
            if (said := encode(value)) != truth and is_taken(answer, value, len(said)):
                self.believed[lie].add(name)


def find_refusals(answer: Answer) -> list[str]:
    """Return what the worker, and the master, have against the truth."""
    refused = []
    for declared in answer.declared:
        try:
            check_result(declared, answer.value)
        except ProtocolError as error:
            refused.append(f"{answer.name}: {error.problem}")
    return refused


def is_taken(answer: Answer, value: object, size_bytes: int) -> bool:
    """Tell whether a master would take a value for what a task returned."""
    if size_bytes > answer.limit_bytes:
        return False
    try:
        check_result(answer.declared[0], value)
    except ProtocolError:
        return False
    return True


def encode(value: object) -> bytes:
    header, buffers = encode_values((value,))
    return header + b"".join(buffers)


def make_torus(points: int) -> PointCloud:
    """With noise, outliers and a hole."""
    rng = np.random.default_rng(2)
    u, v = rng.uniform(0, 2 * np.pi, (2, points))
    normals = np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], axis=1)
    ring = np.stack([np.cos(u), np.sin(u), np.zeros_like(u)], axis=1)
    positions = ring + (0.4 + 0.002 * rng.normal(size=(points, 1))) * normals
    positions[:20] = rng.uniform(-2, 2, (20, 3))
    kept = (positions[:, 0] < 0.9) | (np.abs(positions[:, 1]) > 0.3)
    return PointCloud(positions[kept], normals[kept])


def make_fog(points: int) -> PointCloud:
    rng = np.random.default_rng(3)
    normals = random_directions(points, rng)
    return PointCloud(rng.uniform(-1.0, 1.0, (points, 3)), normals)


def make_lines() -> PointCloud:
    """A wavy sheet, scanned along lines that lie twelve times as far apart as their points, and a
    wire over it."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 3, 0.06), np.arange(0, 3, 0.005)))
    slope = 0.9 * np.cos(3.0 * x)
    normals = np.stack([-slope, np.zeros_like(x), np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    sheet = np.stack([x, y, 0.3 * np.sin(3.0 * x)], axis=1)
    wire = np.linspace([0.0, 1.0, 3.0], [3.0, 1.2, 3.0], 301)
    up = np.tile([0.0, 0.0, 1.0], (len(wire), 1))
    return PointCloud(np.concatenate([sheet, wire]), np.concatenate([normals, up]))


def spoil(cloud: PointCloud) -> PointCloud:
    """Add points at the place of another, markers far away, NaN and a normal without length."""
    assert cloud.normals is not None
    added = np.array([[1e6, 0.0, 0.0], [0.0, -1e7, 3.0], [np.nan] * 3, [0.0, 0.0, 0.4]])
    positions = np.concatenate([cloud.positions, cloud.positions[:200], added])
    normals = np.concatenate([cloud.normals, cloud.normals[:200], np.eye(3), np.zeros((1, 3))])
    return PointCloud(positions, normals)


def open_view(points: int) -> PointCloud:
    torus = make_torus(points)
    return torus.take(np.flatnonzero(torus.positions[:, 2] > 0.0))


def run_small(
    look: Callable[[Answer], None],
    folder: Path,
    cloud: PointCloud,
    sees: bool | None,
    tell: Callable[[Answer], object] = lambda answer: answer.value,
    **more: Any,
) -> None:
    """Run a job through a folder that workers see, or do not see; with None in memory."""
    recorder = RecordedTasks(look, sees=bool(sees), tell=tell)
    write_points(folder / "scan.ply", cloud)
    settings = {"output": str(folder / "mesh.ply"), "grid": 96, **more}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorded_tasks, "make", lambda: recorder, raising=False)
        if sees is not None:  # so many points are too many for memory, and tiles are small
            settings["temp_dir"] = str(folder / "room")
            leave_little_memory(patch, 3_000)
        backend = "recorded_tasks:make"
        run_job(JobSettings(folder / "scan.ply", backend=backend, **settings), Progress())


@pytest.fixture(scope="module")
def looked(tmp_path_factory: pytest.TempPathFactory) -> Looked:
    """What was found of all tasks of some jobs."""
    found, folder = Looked(), tmp_path_factory.mktemp("jobs")
    scan, view = spoil(make_torus(10_000)), open_view(10_000)
    for sees in (None, True, False):
        run_small(found.look, folder, scan, sees)
        run_small(found.look, folder, replace(scan, normals=None), sees)
        run_small(found.look, folder, view, sees, grid=128, output=str(folder / f"{sees}.tiles"))
        run_small(found.look, folder, make_lines(), sees, grid=64)
    run_small(found.look, folder, make_fog(5_000), True, grid=64)
    run_small(found.look, folder, make_torus(3_000), None, grid=256)
    run_small(found.look, folder, make_torus(3_000), None, grid=32, method=Paper())
    return found


@pytest.mark.slow
def test_the_truth_passes(looked: Looked) -> None:
    assert looked.refused == []


@pytest.mark.slow
def test_every_task_is_looked_at(looked: Looked) -> None:
    references = TaskRegistry().references()
    tasks = {of.partition(":")[2] for name, of in references.items() if name.startswith("surface.")}
    assert set(looked.limits) == tasks


@pytest.mark.slow
def test_no_answer_may_be_large(looked: Looked) -> None:
    assert {name for name, limit in looked.limits.items() if limit > MOST_BYTES} == set()


@pytest.mark.slow
@pytest.mark.parametrize("lie", LIES)
def test_only_lies_pass_that_nobody_can_tell(lie: str, looked: Looked) -> None:
    assert looked.believed[lie] == BELIEVED[lie]


@pytest.mark.parametrize(("task", "kept"), [("sum_tile", 3), ("judge_support", 0)])
def test_what_a_worker_has_kept_is_looked_at(task: str, kept: int, tmp_path: Path) -> None:
    def spoil_kept(answer: Answer) -> None:
        if answer.name == task:
            kept_value = answer.arguments[kept]
            assert isinstance(kept_value, tuple)
            place, name = kept_value
            store = open_store(place)
            store.put(name, LIES["plus one"](store.get(name)))

    with pytest.raises(JobError, match="what is kept there is wrong: the result"):
        run_small(spoil_kept, tmp_path, make_torus(8_000), True, output=str(tmp_path / "m.obj"))


@pytest.mark.slow
@pytest.mark.parametrize("lie", ["plus one", "times 1.001"])
@pytest.mark.parametrize("has_normals", [True, False])
def test_lies_that_pass_are_blamed_on_nobody_else(
    has_normals: bool, lie: str, tmp_path: Path
) -> None:
    """Whoever works honestly on what a liar has said is not refused."""
    refused: list[str] = []
    told: set[str] = set()

    def tell(answer: Answer) -> object:
        value = LIES[lie](answer.value)
        if not is_taken(answer, value, len(encode(value))):
            return answer.value
        told.add(answer.name)
        return value

    cloud = spoil(open_view(11_000))
    given = cloud if has_normals else replace(cloud, normals=None)
    run_small(lambda answer: refused.extend(find_refusals(answer)), tmp_path, given, True, tell)
    assert refused == []
    assert told >= {"bound_region"}
