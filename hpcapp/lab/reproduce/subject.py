"""The cloud that a figure is made of."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hpcapp.applications.surface.cloud.arranged import MemoryCloud
from hpcapp.applications.surface.cloud.measure import measure_points
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.methods.method import MethodSettings
from hpcapp.applications.surface.paper.preprocess import denoise, resample
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.applications.surface.pipeline import load
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpcapp.io.points.inputs import gather_points
from hpcapp.lab.simulate.scanner import simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import find_shape
from hpcapp.progress import Progress, StageClock
from hpccomponent.dataclass import dataclass
from hpccomponent.files.held_folders import temporary_folder

#: Points of the example scan.
EXAMPLE_POINTS = 60_000
#: Points of the Stanford bunny of the paper's Figures 2 and 4 and its Section V.
PAPER_BUNNY = 35_947


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """A cloud with unit normals, and its name for people.

    The same points are a PLY in a temporary folder.
    """

    name: str
    points: PointCloud
    path: Path

    @property
    def is_papers(self) -> bool:
        """Whether it has as many points as the paper's bunny."""
        return len(self.points) == PAPER_BUNNY

    def apply_step_1(self) -> PointCloud:
        """Return the points after the paper's step 1: denoised, and resampled to even density."""
        return resample(denoise(self.points))


@contextmanager
def open_subject(points: Path | None) -> Iterator[Subject]:
    """Yield the cloud to make a figure of: the user's, or of a knot, simulated anew.

    Raise InputError where it cannot be read, or holds nothing that can be used.
    """
    with temporary_folder() as folder:
        path = folder / "points.ply"
        if points is None:
            cloud = simulate_scan(
                find_shape("knot"), ScanSettings(points=EXAMPLE_POINTS, views=0, seed=7)
            )
            name = f"simulated knot, {len(cloud)} points"
        else:
            cloud = _read(points)
            name = f"{points.name}, {len(cloud)} points"
        write_points(path, cloud)
        yield Subject(name, cloud, path)


def _read(points: Path) -> PointCloud:
    """Return usable points with normals: the file's, or estimated ones."""
    with gather_points([str(points)]) as path:
        settings = JobSettings(method=Paper(), points=path, output="-", inputs=(points,))
        loaded = load(settings, StageClock(Progress()))
    cloud = loaded.cloud.take_columns(loaded.cloud.keys)
    return PointCloud(cloud.positions, cloud.normals, origin=cloud.origin)


def arrange_for(method: MethodSettings, points: PointCloud) -> MemoryCloud:
    """Return points with unit normals as a method takes them."""
    if method.needs_whole_cloud:  # it cuts the cloud up by itself
        return MemoryCloud.as_they_are(points)
    return measure_points(points)
