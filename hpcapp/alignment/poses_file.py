"""Poses as a JSON file: what an alignment has found, and goes into the next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from hpcapp.alignment.graph import Alignment, Link
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import InputError
from hpccomponent.foreign_json import decode

_TURN_ERROR = 1e-6  # of the product of a rotation with its transpose


class _Poses(TypedDict):
    poses: dict[str, list[list[float]]]


def describe_alignment(alignment: Alignment, names: Sequence[str]) -> dict[str, Any]:
    """Return poses and pairs for a file and for programs.

    A pose is a 4 x 4 matrix by rows, from the coordinates of its file into those of the first.
    """
    return {
        "poses": {
            name: pose.tolist()
            for name, pose in zip(names, alignment.poses, strict=True)
            if pose is not None
        },
        "pairs": [_describe(link, names) for link in alignment.links],
        "unsure": [_describe(link, names) for link in alignment.unsure],
    }


def _describe(link: Link, names: Sequence[str]) -> dict[str, Any]:
    pair = link.pair
    return {
        "fixed": names[link.fixed],
        "moved": names[link.moved],
        "overlap": round(pair.verdict.overlap, 4),
        "residual": float(f"{pair.residual:.4g}"),
        "worth": round(pair.verdict.worth, 4),
        "next_worth": round(pair.next_worth, 4),
        "slid_worth": round(pair.slid_worth, 4),
        "looked_through": round(pair.verdict.through, 4),
    }


def read_poses(path: Path, names: Sequence[str]) -> list[FloatArray]:
    """Read the poses of files, (4, 4) each; InputError where one is missing or no rigid move."""
    try:
        poses = decode(path.read_bytes(), _Poses)["poses"]
        named = {name: np.asarray(poses[name], float) for name in names}
    except KeyError as error:
        raise InputError(
            f"{path}: no pose of {error.args[0]!r}", "name the files as the file of poses does"
        ) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}", "check its name") from error
    except ValueError as error:
        raise InputError(
            f"{path}: is no file of poses: {error}", "give one that --write-poses has written"
        ) from error
    for name, pose in named.items():
        turn = pose[:3, :3]
        if (
            pose.shape != (4, 4)
            or not np.isfinite(pose).all()
            or not np.allclose(turn @ turn.T, np.eye(3), atol=_TURN_ERROR)
            or np.linalg.det(turn) < 0
            or (pose[3] != [0, 0, 0, 1]).any()
        ):
            raise InputError(
                f"{path}: the pose of {name!r} is no rigid move",
                "give a turn and a shift as a 4 x 4 matrix, by rows",
            )
    return list(named.values())
