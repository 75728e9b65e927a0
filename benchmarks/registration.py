"""Which share of the cells of two scans agrees: registration.py [SHAPE ...].

One line for each shape and noise: two stands see half of the points each, from directions that are
40 degrees apart, and one is moved in a random direction by so many spacings. The first columns are
registered scans. A dash: they share too few cells to tell. `AGREEING` of `reading/registration.py`
parts the columns.
"""

from __future__ import annotations

import argparse

import numpy as np

import hpcapp
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.reading.registration import compare_scans
from hpcapp.geometry.points import FloatArray

SHAPES = ("bust", "torus", "knot", "gear", "box")
NOISES = (0.0, 0.3)  # spacings
REGISTERED, MOVED = (0.0, 0.1, 0.3), (3.5, 5.0, 10.0, 20.0, 40.0)
POINTS = 100_000
APART = np.radians(40.0)
LEAST_COSINE = 0.1  # of a normal and the direction of a stand
Random = np.random.Generator


def see(shape: str, noise: float, random: Random) -> list[tuple[FloatArray, FloatArray]]:
    """Return the points that each stand sees, and their normals."""
    cloud = hpcapp.simulate(shape, points=POINTS, views=0, normals="exact", seed=1)
    assert cloud.normals is not None
    spacing = estimate_spacing(cloud.positions)
    stands = ([0.8, 0.0, 0.6], [0.8 * np.cos(APART), 0.8 * np.sin(APART), 0.6])
    turn = random.permutation(len(cloud)) % 2
    scans = []
    for number, stand in enumerate(stands):
        is_seen = (turn == number) & (cloud.normals @ stand > LEAST_COSINE)
        errors = random.normal(0.0, noise * spacing, (int(is_seen.sum()), 3))
        scans.append((cloud.positions[is_seen] + errors, cloud.normals[is_seen].astype(float)))
    return scans


def measure(scans: list[tuple[FloatArray, FloatArray]], shift: float, random: Random) -> str:
    """Return the share of agreeing cells of two scans, one moved by so many spacings."""
    (first, sides), (second, others) = scans
    spacing = max(estimate_spacing(first), estimate_spacing(second))
    arm = random.normal(size=3)
    moved = second + shift * spacing * arm / np.linalg.norm(arm)
    pairs = compare_scans({0: (first, sides), 1: (moved, others)})
    return f"{pairs[0].agreeing / pairs[0].cells:.2f} of {pairs[0].cells}" if pairs else "-"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("shapes", nargs="*", default=SHAPES)
    shapes = parser.parse_args().shapes
    random = np.random.default_rng(0)
    print(f"{'spacings':16}", *(f"{shift:>12}" for shift in REGISTERED + MOVED))
    for shape in shapes:
        for noise in NOISES:
            scans = see(shape, noise, random)
            shares = (measure(scans, shift, random) for shift in REGISTERED + MOVED)
            print(f"{shape:12}{noise:4}", *(f"{share:>12}" for share in shares))


if __name__ == "__main__":
    main()
