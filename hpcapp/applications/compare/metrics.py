"""The distances between a mesh and the truth, in per cent of the truth's diagonal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from hpcapp.applications.compare.nearest import NearestFace, face_normals
from hpcapp.applications.compare.truth import Truth
from hpcapp.applications.surface.stitching.topology import Topology, check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io.points.mesh_samples import sample_faces
from hpcapp.progress import Progress, StageClock
from hpccomponent.dataclass import dataclass

F_THRESHOLDS = (0.02, 0.1, 0.5)  # per cent of the diagonal


@dataclass(frozen=True, slots=True)
class Measures:
    """A mesh against the truth; lengths in per cent of the truth's diagonal.

    Parameters
    ----------
    accuracy : float
        Mean distance from the mesh to the truth; NaN where the truth is open.
    completeness : float
        Mean distance from the truth to the mesh.
    l1 : float
        Mean of the two; the completeness where the truth is open.
    rms : float
        Of both directions' distances together.
    p95 : float
        95 of 100 of both directions' distances are smaller.
    hausdorff : float
        Largest distance met in either direction.
    f_scores : dict of str to float
        Harmonic mean of precision and recall, by threshold in per cent.
    normal_deg : float
        Mean angle between the truth's normal and that of the nearest face, in degrees; NaN where
        the truth has no normals.
    diagonal : float
        Of the truth's bounding box, in length units.
    """

    accuracy: float
    completeness: float
    l1: float
    rms: float
    p95: float
    hausdorff: float
    f_scores: dict[str, float]
    normal_deg: float
    diagonal: float
    topology: Topology


def measure_mesh(
    mesh: Mesh,
    truth: Truth,
    samples: int = 50_000,
    seed: int = 0,
    thresholds: Sequence[float] = F_THRESHOLDS,
    clock: StageClock | None = None,
) -> Measures:
    """Compare a mesh of at least one face with the truth, in whose frame it is.

    So many samples are spread evenly over the area of either surface, the same for the same seed.
    Thresholds of the F-scores are in per cent of the diagonal.
    """
    clock = clock or StageClock(Progress())
    percent = 100.0 / (truth.diagonal or 1.0)
    with clock.stage("truth to mesh"):
        reference = truth.sample(samples, seed)
        backward, faces = NearestFace(mesh).query(reference.positions)
        backward *= percent
    forward = np.empty(0)
    if truth.is_closed:
        with clock.stage("mesh to truth"):
            forward = percent * truth.distance(sample_faces(mesh, samples, seed).positions)
    with clock.stage("check"):
        topology = check_mesh(mesh)
    both = np.concatenate([forward, backward])
    accuracy = float(forward.mean()) if truth.is_closed else float("nan")
    completeness = float(backward.mean())
    return Measures(
        accuracy,
        completeness,
        0.5 * (accuracy + completeness) if truth.is_closed else completeness,
        float(np.sqrt((both**2).mean())),
        float(np.quantile(both, 0.95)),
        float(both.max()),
        {f"{t:g}": _f_score(forward, backward, t) for t in thresholds},
        _mean_angle(reference.normals, face_normals(mesh)[faces]),
        truth.diagonal,
        topology,
    )


def _mean_angle(normals: FloatArray | None, face_normals: FloatArray) -> float:
    """Return the mean angle between unit vectors, in degrees."""
    if normals is None:
        return float("nan")
    cosine = np.einsum("ij,ij->i", normals, face_normals)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).mean())


def _f_score(forward: FloatArray, backward: FloatArray, threshold: float) -> float:
    """Return the harmonic mean of precision and recall; recall alone where the truth is open."""
    recall = float((backward <= threshold).mean())
    if not len(forward):
        return recall
    precision = float((forward <= threshold).mean())
    return 2.0 * precision * recall / max(precision + recall, 1e-12)


def as_json(measures: Measures) -> dict[str, object]:
    """Return measures as plain values; NaN becomes None, which JSON knows."""
    plain = asdict(measures)
    return {name: None if value != value else value for name, value in plain.items()}
