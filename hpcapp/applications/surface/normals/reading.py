"""The reading of a scan whose normals have a side: made once, of its facets.

::

    facets ── who can have seen them so ──> kind, certainty, rivals
         └─── what is missing, and how the border goes on ──> missing, drawn
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.cloud.cloud_pass import CloudPass
from hpcapp.applications.surface.normals.facets import FacetShape, choose_edge, merge_facets
from hpcapp.applications.surface.normals.orientation import ScanVerdict, read_given
from hpcapp.applications.surface.normals.patches import Patches
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.normals.tasks import sum_region
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.applications.surface.types.reading import Measurement, Reading, Rival
from hpcapp.geometry.axes import rotate
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import BoolArray, FloatArray

_NEIGHBOURS = 12  # facets around one
_ONE_SIDED = 0.33  # of the distance of the last of them: their mean, at a border
_FEWEST = 40  # facets that tell
_FARTHEST = 64.0  # cells: facets beyond are no neighbours
_OPPOSED = -0.3  # cosine of normals: what faces the other way is the other side of a plate
_AWAY = 4.0  # half diagonals of the box from its middle: a place that sees one side


def read_scan(
    cloud_pass: CloudPass,
    scale: LocalScale,
    sensor: Sensor,
    is_upright: bool,
    verdict: ScanVerdict | None = None,
) -> Reading:
    """Judge what a scan is of, and how it was seen.

    The points' normals have their side; `is_upright` says that z is known to point up. The verdict
    is how it was seen, where that has given the normals their side; of known places, whether they
    are among the points is asked here.
    """
    cloud = cloud_pass.cloud
    edge = choose_edge(len(cloud), scale.spacing)
    corner = lay_lattice(cloud.low, edge)
    facets = merge_facets(cloud_pass.each(sum_region, corner, edge))
    shape = FacetShape.of(facets, corner, edge, scale)
    if verdict is None or verdict.kind == "places":
        upright = sensor.upright
        given = shape.patches.rotate(upright), shape.spacing, rotate(-cloud.origin, upright)
        verdict = read_given(*given, sensor.rotate(), cloud_pass.threads)
    drawn = measure_drawn(shape.patches, shape.missing, edge)
    box = np.stack([cloud.low, cloud.high])
    rivals = tuple(
        Rival(kind, probability, _name_option(kind, box + cloud.origin))
        for kind, probability in verdict.rivals
    )
    missing = float(np.linalg.norm(shape.missing))
    return Reading(
        kind=verdict.kind,
        certainty=verdict.certainty,
        up="z" if is_upright else None,
        missing=tuple(shape.missing.tolist()),
        drawn=drawn,
        rivals=rivals,
        because=(
            *verdict.because,
            Measurement("length of the mean normal", missing),
            Measurement("mean cosine from the border on to the missing side", drawn),
        ),
    )


def measure_drawn(patches: Patches, missing: FloatArray, edge: float) -> float:
    """Return how far a surface goes on, at its border, towards what is missing: a mean cosine.

    At the border of an object that stood on a table the surface goes on towards the table; at that
    of a terrain or of a view it goes on sideways, along itself. The patches have their sides, and
    lie in cells of an `edge`; `missing` is (3,).
    """
    length = float(np.sqrt(missing @ missing))
    if len(patches) < _FEWEST or not length:
        return 0.0
    is_border, onwards = _find_border(patches, edge)
    weights = patches.counts[is_border].astype(np.float64)
    drawn = (weights * (onwards @ missing)).sum() / (length * max(float(weights.sum()), 1e-300))
    return float(drawn)


def _find_border(patches: Patches, edge: float) -> tuple[BoolArray, FloatArray]:
    """Return which facets have neighbours on one side only, and the way on from each of these."""
    centres, normals, every = patches.centres, patches.normals, np.arange(len(patches))
    boxes = kernels.sort_points(centres, lay_lattice(centres.min(axis=0), edge), edge)
    squares, near = kernels.find_nearest(
        centres, *boxes, edge, every, _NEIGHBOURS, _FARTHEST * edge
    )
    found = near < len(patches)
    near = np.where(found, near, every[:, None])
    # (p, 12, 3): to the neighbours, as far as they are of the same side of a plate.
    arms = centres[near] - centres[:, None]
    is_same = found & (np.einsum("pki,pi->pk", normals[near], normals) > _OPPOSED)
    count = np.maximum(is_same.sum(axis=1), 1)
    mean = (arms * is_same[:, :, None]).sum(axis=1) / count[:, None]
    # (p, 3): along the surface: inwards at a border, else about 0.
    mean -= np.einsum("pi,pi->p", mean, normals)[:, None] * normals
    lengths = np.sqrt(np.einsum("pi,pi->p", mean, mean))
    far = np.sqrt(np.where(is_same, squares, 0.0).max(axis=1))
    is_border = (lengths > _ONE_SIDED * far) & (lengths > 0.0)
    onwards: FloatArray = -mean[is_border] / lengths[is_border, None]
    return is_border, onwards


def _name_option(kind: str, box: FloatArray) -> str:
    """Return what ``--viewpoint`` says that a scan in a box was seen so."""
    if kind in ("outside", "inside", "above", "below"):
        return kind
    if kind == "sensor":
        return "0,0,0"
    if kind.startswith("around"):
        return "outside"
    signs = {"+": 1.0, "-": -1.0}
    side = np.zeros(3)
    for sign, axis in zip(kind[::2], kind[1::2], strict=False):
        if sign in signs and axis in "xyz":
            side["xyz".index(axis)] = signs[sign]
    if not side.any():
        return ""
    diagonal = float(np.linalg.norm(box[1] - box[0]))
    place = box.mean(axis=0) + 0.5 * _AWAY * diagonal * side / np.linalg.norm(side)
    return ",".join(f"{value:.4g}" for value in place.tolist())
