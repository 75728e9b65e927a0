"""Files of points brought into one frame: drawn from, aligned, and read where they lie then."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from hpcapp.alignment.graph import Alignment, Link, align_scans
from hpcapp.alignment.pose import move
from hpcapp.alignment.poses_file import read_poses
from hpcapp.alignment.sample import Sample
from hpcapp.alignment.viewpoint import see_scan
from hpcapp.extras import how_to_install
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.ply.joined import refuse_mixed
from hpcapp.io.points.point_source import PointSource, Scan
from hpccomponent.errors import InputError

log = logging.getLogger("hpcapp")

_DRAWN = 300_000  # points of a scan
_FEWEST = 300
_ROWS = 1 << 18


def align_sources(
    sources: Sequence[PointSource],
    names: Sequence[str],
    near: float | None = None,
    poses: Path | None = None,
) -> tuple[list[PointSource], Alignment]:
    """Return sources in the frame of the first, and how they came there.

    Parameters
    ----------
    names : sequence of str
        The files as the user has named them.
    near : float, optional
        They lie right up to this length.
    poses : Path, optional
        A file of poses: nothing is searched.

    Raises
    ------
    InputError
        A scan cannot be placed surely, has too few points or coordinates that cannot be turned; or
        the file of poses lacks one.
    """
    refuse_mixed(sources, ("unit", "height_unit"))
    for source, name in zip(sources, names, strict=True):
        if source.unit == "degree" or source.frame.height_scale != 1.0:
            raise InputError(
                f"{name}: coordinates in more than one unit cannot be turned",
                "convert them to a projected coordinate system with one unit",
            )
    if poses is not None:
        alignment = Alignment(tuple(read_poses(poses, names)), (), ())
    else:
        alignment = _search(sources, names, near)
    placed = [pose for pose in alignment.poses if pose is not None]
    return [move_source(*pair, sources[0]) for pair in zip(sources, placed, strict=True)], alignment


def _search(sources: Sequence[PointSource], names: Sequence[str], near: float | None) -> Alignment:
    """Find the pose of every source, or refuse."""
    if find_spec("kiss_matcher") is None:
        log.warning(
            "warning: features of the surface take no part, which curved things need: %s",
            how_to_install("align"),
        )
    samples = [draw_sample(source, name) for source, name in zip(sources, names, strict=True)]
    alignment = align_scans(
        samples, near, lambda i, j: log.info("aligning %s with %s", names[j], names[i])
    )
    _refuse_unplaced(alignment, names)
    for link in alignment.links:
        log.info("%s", describe_link(link, names))
    return alignment


def draw_sample(source: PointSource, name: str) -> Sample:
    """Draw points of a source, evenly, in one pass; memory is bounded."""
    rng, share, parts, drawn = np.random.default_rng(0), 1.0, list[FloatArray](), 0
    for part in source.chunks(_ROWS):
        positions = part.positions[np.isfinite(part.positions).all(axis=1)]
        parts.append(positions[rng.random(len(positions)) < share])
        drawn += len(parts[-1])
        while drawn > 2 * _DRAWN:
            parts = [kept[rng.random(len(kept)) < 0.5] for kept in parts]
            share, drawn = share / 2, sum(map(len, parts))
    positions = np.concatenate(parts)
    positions = positions[rng.permutation(len(positions))[:_DRAWN]]
    if len(np.unique(positions, axis=0)) < _FEWEST:
        raise InputError(
            f"{name}: fewer than {_FEWEST} usable points are too few to align", "leave it out"
        )
    scanners = [scan.scanner for scan in source.scans]
    return see_scan(positions, scanners[0] if len(scanners) == 1 else None)


def move_source(source: PointSource, pose: FloatArray, first: PointSource) -> PointSource:
    """Return a source whose points, normals and scanners are moved into the frame of the first."""
    if source is first and (pose == np.eye(4)).all():
        return source

    def scan(rows: int) -> Iterator[PointCloud]:
        return map(partial(_move_cloud, pose), source.scan(rows))

    def move_scan(one: Scan) -> Scan:
        if one.scanner is None:
            return one
        return replace(one, scanner=move(pose, one.scanner[None])[0])

    return replace(
        source, is_double=True, scan=scan, records=None, octree=None, upright=None,
        scans=tuple(map(move_scan, source.scans)), crs=first.crs, is_flown=first.is_flown,
        is_projected=first.is_projected, unit=source.unit or first.unit,
    )  # fmt: skip


def describe_link(link: Link, names: Sequence[str]) -> str:
    """Return in words what was found between two scans."""
    pair = link.pair
    return (
        f"{names[link.moved]} on {names[link.fixed]}: overlap {pair.verdict.overlap:.0%}, "
        f"residual {pair.residual:.3g}, worth {pair.verdict.worth:.2f} "
        f"(of the next best pose {pair.next_worth:.2f})"
    )


def _move_cloud(pose: FloatArray, cloud: PointCloud) -> PointCloud:
    normals = cloud.normals
    if normals is not None:
        normals = (normals @ pose[:3, :3].T).astype(normals.dtype)
    return replace(cloud, positions=move(pose, cloud.positions + cloud.origin), normals=normals,
                   origin=np.zeros(3))  # fmt: skip


def _refuse_unplaced(alignment: Alignment, names: Sequence[str]) -> None:
    """Raise InputError where a scan hangs on no sure pair."""
    unplaced = [number for number, pose in enumerate(alignment.poses) if pose is None]
    if not unplaced:
        return
    best = max(alignment.unsure, key=lambda link: link.pair.verdict.worth)
    raise InputError(
        f"{', '.join(names[number] for number in unplaced)}: not to be aligned surely; "
        f"the best pair is {describe_link(best, names)}",
        "scans that look alike from several sides, or overlap little, need a start: register them "
        "by hand up to some distance and say it with --max-shift, give poses with --poses, or add "
        "a scan between them",
    )
