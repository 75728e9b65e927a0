"""How far beyond a box points must be read: crop_margin.py.

One line for each box and margin: how far the mesh of the box is from that of the whole, within a
spacing of the border and farther in, as RMS in spacings. From the margin on at which both are the
same, more points change nothing: some five spacings. `MARGIN` of `job/source.py` is that for boxes
of 25 spacings and more.
"""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
from scipy.spatial import cKDTree

import hpcapp
from hpcapp.api.mesh import Mesh
from hpcapp.geometry.mesh import Mesh as Plain
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.geometry.regions.clipping import clip_mesh
from hpcapp.geometry.regions.region import Region
from hpcapp.io.points.mesh_samples import sample_faces

Box = tuple[float, float, float, float, float, float]

BOXES: tuple[Box, ...] = ((5.0, -3.0, -10.0, 15.0, 7.0, 10.0), (9.0, -2.0, 2.0, 15.0, 4.0, 8.0))
"""Through the knot: of 56 and of 17 spacings."""
MARGINS = (0.0, 0.025, 0.05, 0.1, 0.2, 0.4)
_PLACES, _DENSE = 20_000, 200_000


def simulate_knot() -> PointCloud:
    """Return a noisy scan, whose normals are to be estimated."""
    return hpcapp.simulate("knot", points=20_000, noise=0.003)


def crop_job(scan: PointCloud, whole: Mesh, box: Box, margin: float) -> Mesh:
    """Return what a job makes of a box with a margin, on the grid of the whole."""
    with patch("hpcapp.api.reconstruction.MARGIN", margin):
        step = whole.facts["step"]
        return hpcapp.reconstruct(scan, "estimate", box=box, voxel_size=step, executor="serial")


def measure_edge(whole: Mesh, part: Mesh, box: Box) -> tuple[float, float]:
    """Return the RMS distance within a spacing of the border, and farther in, in spacings."""
    region = Region.box(np.array(box[:3]), np.array(box[3:]))
    spacing = float(whole.facts["spacing"])
    cut = clip_mesh(Plain(np.array(whole.vertices), np.array(whole.faces)), region)
    theirs = Plain(np.array(part.vertices), np.array(part.faces))
    gaps: list[FloatArray] = []
    squares: list[FloatArray] = []
    for one, other in ((cut, theirs), (theirs, cut)):
        places = sample_faces(one, _PLACES).positions
        gaps.append(np.minimum(places - region.low, region.high - places).min(axis=1))
        tree = cKDTree(sample_faces(other, _DENSE).positions)
        squares.append((tree.query(places)[0] / spacing) ** 2)
    is_near, square = np.concatenate(gaps) < spacing, np.concatenate(squares)
    return float(np.sqrt(square[is_near].mean())), float(np.sqrt(square[~is_near].mean()))


def main() -> None:
    """Print the table."""
    scan = simulate_knot()
    whole = hpcapp.reconstruct(scan, "estimate", executor="serial")
    for box in BOXES:
        for margin in MARGINS:
            near, far = measure_edge(whole, crop_job(scan, whole, box, margin), box)
            print(f"{box}: margin {margin:5.3f}: {near:.3f} at the border, {far:.3f} farther in")


if __name__ == "__main__":
    main()
