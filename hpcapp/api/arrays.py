"""Checks arrays and clouds from Python once, where they come in; errors name the argument."""

from __future__ import annotations

from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hpcapp.geometry.points import ByteArray, FloatArray, IntArray, PointCloud
from hpcapp.io import drop_unusable
from hpcapp.io.frame import to_local
from hpccomponent.errors import InputError, UsageError

Number = TypeVar("Number", bound=np.generic)


def check_cloud(
    points: ArrayLike | PointCloud, normals: ArrayLike | None, name: str = "points"
) -> PointCloud:
    """Return the arrays as a cloud in its local frame; InputError names the argument at fault."""
    points = _adopt(points, name)
    if isinstance(points, PointCloud):
        if normals is not None:
            raise UsageError("normals stands beside a cloud", "give the cloud its normals")
        given = points
    else:
        given = PointCloud(check_rows(name, points), _check_normals(normals))
    positions, directions = check_rows(name, given.positions), _check_normals(given.normals)
    if directions is not None and len(positions) != len(directions):
        raise InputError(
            f"{name} has {len(positions)} rows and normals {len(directions)}",
            "give one normal for each point",
        )
    colours = None if given.colours is None else check_colours(given.colours, len(positions))
    attributes = {
        label: check_column(label, column, len(positions))
        for label, column in given.attributes.items()
    }
    local, origin = (positions, given.origin) if given.origin.any() else to_local(positions)
    whole = PointCloud(local, directions, colours, attributes, origin)
    cloud, dropped = drop_unusable(whole, name)
    if dropped.total:
        raise InputError(
            f"normals has {dropped.total} of {len(positions)} rows of length zero",
            "leave those points out",
        )
    return cloud


def _adopt(points: Any, name: str) -> ArrayLike | PointCloud:
    """Return a cloud of Open3D, trimesh or a library alike as ours; all else as it is."""
    places = getattr(points, "points", getattr(points, "vertices", None))
    if places is None:
        if hasattr(points, "to_legacy"):
            raise UsageError(f"{name} is a {_name(points)}", f"give {name}.to_legacy()")
        return cast(ArrayLike, points)
    if any(len(getattr(points, faces, ())) for faces in ("faces", "triangles")):
        raise UsageError(
            f"{name} is a {_name(points)}, which has faces",
            "sample points on them first: mesh.sample(100_000) of trimesh, "
            "mesh.sample_points_uniformly(100_000) of Open3D",
        )
    normals, colours = (getattr(points, column, None) for column in ("normals", "colors"))
    normals = None if normals is None or not len(normals) else check_rows("normals", normals)
    if colours is None or not len(colours):
        return PointCloud(check_rows(name, places), normals)
    values = np.asarray(colours)[:, :3]
    if values.dtype.kind == "f":  # from 0 to 1
        values = np.rint(255.0 * values.clip(0.0, 1.0)).astype(np.uint8)
    return PointCloud(check_rows(name, places), normals, values)


def _name(value: object) -> str:
    """Return the type of an object as its user knows it."""
    kind = type(value)
    return f"{kind.__module__.partition('.')[0]} {kind.__name__}"


def _check_normals(normals: ArrayLike | None) -> FloatArray | None:
    return None if normals is None else check_rows("normals", normals)


def check_colours(values: ArrayLike, points: int) -> ByteArray:
    """Return colours as bytes, where they are those of so many points."""
    array = np.asarray(values)
    if array.shape != (points, 3):
        raise InputError(
            f"colours has the shape {array.shape}, not ({points}, 3)",
            "give red, green and blue of each point",
        )
    if array.dtype.kind not in "iu" or (points and not 0 <= array.min() <= array.max() <= 255):
        raise InputError(
            f"colours holds {array.dtype} beyond whole numbers from 0 to 255",
            "scale them to 0 to 255, as uint8",
        )
    return np.ascontiguousarray(array, dtype=np.uint8)


def check_column(name: str, values: ArrayLike, points: int) -> NDArray[Any]:
    """Return an attribute as an array, where it has a number for each of so many points."""
    array = np.asarray(values)
    if array.shape != (points,) or array.dtype.kind not in "biuf":
        raise InputError(
            f"the attribute {name!r} holds {array.dtype} of the shape {array.shape}",
            f"give numbers, one for each of the {points} points",
        )
    return array


def check_rows(name: str, values: ArrayLike, count: int | None = None) -> FloatArray:
    """Return `values` as rows of three finite numbers, float64, and `count` of them if told."""
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"{name} is no array ({error})", "give rows of three numbers") from None
    if array.dtype.kind not in "biuf":
        raise InputError(
            f"{name} holds {array.dtype}, not numbers", "give rows of three numbers, for instance "
            "a float64 array of shape (n, 3)"
        )  # fmt: skip
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(
            f"{name} has the shape {array.shape}, not (n, 3)", "give one row of three per point"
        )
    finite = np.logical_and.reduce([np.isfinite(column) for column in array.T])
    if not finite.all():
        raise InputError(
            f"{name} has {int((~finite).sum())} of {len(array)} rows with NaN or infinity, first "
            f"{name}[{int(np.argmin(finite))}]",
            "leave those points out",
        )
    if count is not None and len(array) != count:
        raise InputError(f"{name} has {len(array)} rows, not {count}", "give one for each vertex")
    return np.ascontiguousarray(array, dtype=np.float64)


def check_faces(values: ArrayLike, vertices: int) -> IntArray:
    """Return faces as int64, where their corners are rows of so many vertices."""
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise InputError(
            f"faces holds {array.dtype} of the shape {array.shape}",
            "give three whole numbers for each face",
        )
    if len(array) and not 0 <= array.min() <= array.max() < vertices:
        raise InputError(
            f"faces has corners from {array.min()} to {array.max()}",
            f"give rows of the {vertices} vertices",
        )
    return np.ascontiguousarray(array, dtype=np.int64)


def read_only(array: NDArray[Number]) -> NDArray[Number]:
    """Return a view of an array that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view
