"""Scans of a room from its stands, each in a frame of its own, with the truth."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from hpcapp.alignment.pose import invert, make_pose, move
from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate.raw.scan import RawSettings, scan_scene


@cache
def scan_stands(points: int = 12_000) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Return the points of each stand in a frame of its own, and the pose into the room."""
    raw = scan_scene("room", "terrestrial", RawSettings(points=points, noise=0.003))
    turns = Rotation.random(2, random_state=np.random.default_rng(3)).as_matrix()
    scans = []
    for number, turn in enumerate(turns, 1):
        eye = raw.trajectory[0 if number == 1 else -1, 1:]
        pose = make_pose(turn.T, eye)  # from the scanner's frame
        of_stand = raw.cloud.attributes["point_source_id"] == number
        scans.append((move(invert(pose), raw.cloud.positions[of_stand]), pose))
    return tuple(scans)


def true_pose() -> FloatArray:
    """Return the pose of the second stand's points in the frame of the first."""
    (_, first), (_, second) = scan_stands()
    return invert(first) @ second
