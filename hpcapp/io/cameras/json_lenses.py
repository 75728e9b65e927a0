"""The lenses of camera files in JSON, as each program names their numbers.

A lens that is incomplete, or of a model that is not known here, is None: the pose counts all the
same.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import tan

import msgspec

from hpcapp.io.cameras.lens import Lens
from hpccomponent.foreign_json import decode_large

_FISHEYES = ("OPENCV_FISHEYE", "FISHEYE")
_PINHOLES = ("", "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")


class PinholeFields(msgspec.Struct):
    """What transforms.json says of a lens, for all frames or for one."""

    camera_model: str | None = None
    w: float | None = None
    h: float | None = None
    fl_x: float | None = None
    fl_y: float | None = None
    cx: float | None = None
    cy: float | None = None
    k1: float | None = None
    k2: float | None = None
    k3: float | None = None
    k4: float | None = None
    p1: float | None = None
    p2: float | None = None
    camera_angle_x: float | None = None


def read_common(whole: Mapping[str, msgspec.Raw]) -> PinholeFields:
    """Return what transforms.json says for all frames; nothing where it is of other types."""
    common = {name: whole[name] for name in PinholeFields.__struct_fields__ if name in whole}
    try:
        return decode_large(msgspec.json.encode(common), PinholeFields)
    except ValueError:
        return PinholeFields()


def make_pinhole(common: PinholeFields, own: PinholeFields) -> Lens | None:
    """Return the lens of a frame: what it does not say itself is that of all frames."""
    names = PinholeFields.__struct_fields__
    told = {name: value for name in names if (value := getattr(own, name)) is not None}
    said = msgspec.structs.replace(common, **told)
    model = (said.camera_model or "").upper()
    if model not in (*_PINHOLES, *_FISHEYES):
        return None
    size, focal = (said.w or 0.0, said.h or 0.0), said.fl_x or 0.0
    if not focal and said.camera_angle_x:
        size = size if said.w else (1.0, 0.0)  # the angle is across the picture, whatever its width
        focal = 0.5 * size[0] / tan(0.5 * said.camera_angle_x)
    offset = tuple(
        0.0 if middle is None or not side else middle - 0.5 * side
        for middle, side in zip((said.cx, said.cy), size, strict=True)
    )
    k1, k2, k3, k4, p1, p2 = (
        number or 0.0 for number in (said.k1, said.k2, said.k3, said.k4, said.p1, said.p2)
    )
    return _make(
        size, (focal, said.fl_y or focal), offset, (k1, k2, k3, k4), (p1, p2),
        is_fisheye=model in _FISHEYES,
    )  # fmt: skip


class OpensfmCamera(msgspec.Struct):
    """A camera of reconstruction.json, whose lengths are in the longer side of the picture.

    https://opensfm.org/docs/geometry.html
    """

    projection_type: str = "perspective"
    width: float = 0.0
    height: float = 0.0
    focal: float = 0.0
    focal_x: float = 0.0
    focal_y: float = 0.0
    c_x: float = 0.0
    c_y: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


_OF_OPENSFM = {
    "perspective": False,
    "simple_radial": False,
    "radial": False,
    "brown": False,
    "fisheye": True,
    "fisheye_opencv": True,
}
"""Which are fisheyes."""


def read_opensfm_lens(raw: msgspec.Raw) -> Lens | None:
    """Return the lens of a camera of reconstruction.json."""
    try:
        camera = decode_large(raw, OpensfmCamera)
    except ValueError:
        return None
    longest = max(camera.width, camera.height)
    if camera.projection_type not in _OF_OPENSFM or not longest:
        return None
    x = camera.focal or camera.focal_x
    return _make(
        (camera.width, camera.height),
        (x * longest, (camera.focal_y or x) * longest),
        (camera.c_x * longest, camera.c_y * longest),
        (camera.k1, camera.k2, camera.k3, camera.k4),
        (camera.p1, camera.p2),
        is_fisheye=_OF_OPENSFM[camera.projection_type],
    )


class _OpenmvgNumbers(msgspec.Struct):
    width: float
    height: float
    focal_length: float
    principal_point: tuple[float, float]
    disto_k1: list[float] = []
    disto_k3: list[float] = []
    disto_t2: list[float] = []
    fisheye: list[float] = []


class _OpenmvgPointer(msgspec.Struct):
    data: _OpenmvgNumbers


class _OpenmvgValue(msgspec.Struct):
    ptr_wrapper: _OpenmvgPointer


class _OpenmvgIntrinsic(msgspec.Struct):
    value: _OpenmvgValue
    key: int = -1


def read_openmvg_lenses(raw: msgspec.Raw) -> dict[int, Lens | None]:
    """Return the lenses of sfm_data.json by their numbers."""
    try:
        intrinsics = decode_large(raw, list[_OpenmvgIntrinsic])
    except ValueError:
        return {}
    return {one.key: _make_openmvg(one.value.ptr_wrapper.data) for one in intrinsics}


def _make_openmvg(told: _OpenmvgNumbers) -> Lens | None:
    k1, k2, k3, t1, t2 = (*told.disto_t2, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    return _make(
        (told.width, told.height),
        (told.focal_length, told.focal_length),
        (told.principal_point[0] - 0.5 * told.width, told.principal_point[1] - 0.5 * told.height),
        tuple(told.fisheye or told.disto_k3 or told.disto_k1 or (k1, k2, k3)),
        (t1, t2),
        is_fisheye=bool(told.fisheye),
    )


def _make(
    size: tuple[float, float],
    focal: tuple[float, float],
    offset: tuple[float, ...],
    radial: tuple[float, ...],
    tangential: tuple[float, float],
    *,
    is_fisheye: bool,
) -> Lens | None:
    if min(focal) <= 0.0:
        return None
    across, down = offset
    return Lens(size, focal, (across, down), radial, (), tangential, is_fisheye=is_fisheye)
