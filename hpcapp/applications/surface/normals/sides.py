"""Whether the normals of a cloud agree on a side, what gives them one, and what they tell then.

Every job asks; what estimates normals (`normals`) is only imported where it is needed.
"""

from __future__ import annotations

from dataclasses import replace

from hpcapp.applications.surface.cloud.cloud_pass import CloudPass, PassT
from hpcapp.applications.surface.cloud.measure import draw_boxes
from hpcapp.applications.surface.normals import patches
from hpcapp.applications.surface.normals.consistency import share_opposed, weigh_torn
from hpcapp.applications.surface.normals.oriented import Judgement, Oriented
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.applications.surface.types.reading import Reading
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import FloatArray
from hpcapp.progress import StageClock

_SAMPLE = 20_000  # points that show whether normals contradict each other
CONTRADICTING = 0.12
"""Share of opposite pairs from which on normals have no side: 6 in 100 turned round. Files whose
normals have one have .096 or less (leaves of a plant), others .176 and more; signs by chance .5."""


def orient_cloud(
    cloud_pass: PassT,
    scale: LocalScale,
    wanted: str,
    sensor: Sensor,
    clock: StageClock,
    *,
    has_normals: bool,
    is_oriented: bool = True,
    is_upright: bool = False,
    attribute: str | None = None,
) -> tuple[PassT, Oriented, Reading]:
    """Give points normals where they have none, or such that contradict each other, and read them.

    Normals that are there are taken as they are if ``file`` is `wanted`; `is_oriented` says that
    the file gives them a side, `is_upright` that z is known to point up. By the name of an
    `attribute` points keep how sure their side is, 0 to 1. Returned are points with unit normals,
    how these came about, and the reading of this job.
    """
    from hpcapp.applications.surface.normals.reading import read_scan

    if has_normals:
        judgement = judge_normals(cloud_pass, scale.spacing)
        if wanted == "file" or (is_oriented and judgement == "agree"):
            oriented = Oriented("file", 1.0, judgement=judgement)
            return cloud_pass, oriented, read_scan(cloud_pass, scale, sensor, is_upright)
    from hpcapp.applications.surface.normals.drive import orient_normals  # takes its time

    with clock.stage("normals"):
        cloud_pass, found, verdict = orient_normals(
            cloud_pass, scale.spacing, sensor, keeps=has_normals, attribute=attribute
        )
        reading = read_scan(cloud_pass, scale, sensor, is_upright, verdict)
    if has_normals:
        return cloud_pass, replace(found, source="file", judgement=judgement), reading
    return cloud_pass, replace(found, flipped=0), reading


def judge_normals(cloud_pass: CloudPass, spacing: float) -> Judgement:
    """Tell whether normals agree on their side, by the points in a sample of boxes."""
    boxes = _draw_neighbours(cloud_pass, spacing)
    if share_opposed(*boxes, spacing) > CONTRADICTING:
        return "contradict"
    return "follow a place" if weigh_torn(*boxes, spacing).is_torn else "agree"


def measure_opposed(cloud_pass: CloudPass, spacing: float) -> float:
    """Return the share of neighbouring normals that oppose each other, by the same sample."""
    return share_opposed(*_draw_neighbours(cloud_pass, spacing), spacing)


def _draw_neighbours(
    cloud_pass: CloudPass, spacing: float
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return positions and normals in some boxes, the lattice of these, and their edge."""
    edge, points = patches.CELL * spacing, len(cloud_pass.cloud)
    # All points of a few boxes: pairs need neighbours, which a sample of points has not.
    positions, normals = draw_boxes(cloud_pass, edge, points // _SAMPLE + 1)
    return positions, normals, lay_lattice(cloud_pass.cloud.low, edge), edge
