"""``hpcapp.simulate``: scans of shapes whose true surface is known."""

from __future__ import annotations

from typing import Literal

from hpcapp.geometry.points import PointCloud
from hpcapp.lab.simulate.scanner import simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import find_shape


def simulate(
    shape: str,
    *,
    points: int = 100_000,
    views: int = 20,
    noise: float = 0.0,
    drift: float = 0.0,
    correlation: float = 0.05,
    dropout: float = 0.0,
    grazing: float = 80.0,
    pose_error: float = 0.0,
    outliers: float = 0.0,
    density_ratio: float = 1.0,
    missing: int = 0,
    flipped: float = 0.0,
    normals: Literal["pca", "exact"] = "pca",
    seed: int = 0,
) -> PointCloud:
    """Scan a model, as ``hpcapp simulate --shape`` does.

    Parameters
    ----------
    shape : str
        Which model; an unknown name lists all. `compare` measures against ``shape:NAME``.
    points : int
        Exactly so many.
    views : int
        Positions of the scanner about the model; 0 samples the whole surface evenly.
    noise : float
        Standard deviation of the depth, as a fraction of the diagonal.
    drift, correlation : float
        Standard deviation of a smooth error of each view's depth, and the length over which it
        changes, as fractions of the diagonal.
    dropout : float
        Share of each view that is lost, in blotches.
    grazing : float
        Greatest angle of incidence that still echoes, in degrees.
    pose_error : float
        Misplacement of each view, as a fraction of the diagonal.
    outliers : float
        Share of the points that are wrong.
    density_ratio : float
        Density at the dense end over that at the sparse end.
    missing : int
        Balls from which nothing came back.
    flipped : float
        Share of the points whose normal has the wrong sign.
    normals : {"pca", "exact"}
        From the neighbours' plane, or the model's own.
    seed : int
        One seed gives one scan.

    Raises
    ------
    UsageError
        There is no such model, or a value is out of its range.

    Examples
    --------
    >>> import hpcapp
    >>> len(hpcapp.simulate("torus", points=2000, noise=0.001))
    2000
    """
    settings = ScanSettings(
        points, views, noise, drift, correlation, dropout, grazing, pose_error, outliers,
        density_ratio, missing, flipped, normals, seed,
    )  # fmt: skip
    return simulate_scan(find_shape(shape), settings)
