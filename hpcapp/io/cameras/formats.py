"""Camera files, one entry for each format: how it is told by what a file holds, and its reader."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np

from hpcapp.geometry.paths import MOST_PLACES
from hpcapp.geometry.points import FloatArray
from hpcapp.io.cameras.bundler import read_bundle
from hpcapp.io.cameras.colmap import (
    find_colmap_part,
    has_images,
    read_images_binary,
    read_images_text,
)
from hpcapp.io.cameras.json_poses import (
    JsonObject,
    read_frames,
    read_openmvg,
    read_opensfm,
    split_json,
)
from hpcapp.io.cameras.metashape import read_metashape
from hpcapp.io.cameras.poses import Camera, list_places
from hpcapp.io.points.point_source import translated
from hpcapp.io.text.lines import find_encoding
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError
from hpccomponent.ranges import FARTHEST

Kind = Literal["binary", "XML", "JSON", "text"]

_HEAD = 4096  # characters that tell a text
_LARGEST_JSON = 1 << 30  # bytes: it is read whole
_LONGEST_PROBLEM = 300
_IN_FOLDER = ("images.bin", "images.txt")  # of a model of COLMAP; the first is its own choice


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """What is known of a file before it is read.

    That is the encoding and the head of a text, empty where it is none, or JSON's objects.
    """

    path: Path
    kind: Kind
    encoding: str = ""
    head: str = ""
    objects: tuple[JsonObject, ...] = ()

    def has_key(self, key: str) -> bool:
        """Tell whether an object of the JSON has a key."""
        return any(key in one for one in self.objects)


@dataclass(frozen=True, slots=True)
class CameraFormat:
    """A format of camera files, by program and usual name, a dialect of some kind.

    `tells` says whether content of that kind is this format's; `read` returns the cameras, or
    raises ValueError where the file is damaged.
    """

    name: str
    kind: Kind
    tells: Callable[[Content], bool]
    read: Callable[[Content], list[Camera]]


FORMATS = (
    CameraFormat(
        "COLMAP (images.bin)",
        "binary",
        lambda _: True,
        lambda c: read_images_binary(c.path),
    ),
    CameraFormat(
        "COLMAP (images.txt)",
        "text",
        lambda c: has_images(c.head),
        lambda c: read_images_text(c.path, c.encoding),
    ),
    CameraFormat(
        "Bundler (bundle.out)",
        "text",
        lambda c: c.head.startswith("# Bundle file"),
        lambda c: read_bundle(c.path, c.encoding),
    ),
    CameraFormat(
        "nerfstudio or instant-ngp (transforms.json)",
        "JSON",
        lambda c: c.has_key("frames"),
        lambda c: read_frames(c.objects),
    ),
    CameraFormat(
        "OpenMVG (sfm_data.json)",
        "JSON",
        lambda c: c.has_key("extrinsics"),
        lambda c: read_openmvg(c.objects),
    ),
    CameraFormat(
        "OpenSfM or OpenDroneMap (reconstruction.json)",
        "JSON",
        lambda c: c.has_key("shots"),
        lambda c: read_opensfm(c.objects),
    ),
    CameraFormat(
        "Metashape (cameras.xml)",
        "XML",
        lambda c: bool(re.search(r"<document[\s>]", c.head)),
        lambda c: read_metashape(c.path),
    ),
)


def find_camera_file(path: Path) -> Path:
    """Return the file of cameras that a path means: itself, or the one of a folder of COLMAP.

    Raise InputError where a folder has none.
    """
    if not path.is_dir():
        return path
    for name in _IN_FOLDER:
        if (path / name).is_file():
            return path / name
    raise InputError(
        f"{path}: the folder has neither {' nor '.join(_IN_FOLDER)}, as a model of COLMAP has",
        "name the file of cameras, or the folder, such as sparse/0",
    )


def read_places(path: Path) -> FloatArray | None:
    """Read where photographs were taken from; see `read_cameras`.

    Return the centre and the direction (n, 6) of at most 64 cameras, far from each other.
    """
    cameras = read_cameras(path)
    return None if cameras is None else spread_places(list_places(cameras))


def read_cameras(path: Path) -> list[Camera] | None:
    """Read the cameras of photographs in the file's coordinates, whatever it is named.

    Return None where a text is no camera file: it may be a trajectory. Raise InputError where it
    is damaged, or neither a camera file nor a text.
    """
    with translated(path):
        content = _open(path)
        found = next((f for f in FORMATS if f.kind == content.kind and f.tells(content)), None)
        if found is None:
            _refuse_other(content)
            return None
        try:
            cameras = found.read(content)
            _check(list_places(cameras))
        except ValueError as error:
            raise InputError(
                f"{path}: is {content.kind}, read as cameras of {found.name}: "
                + str(error)[:_LONGEST_PROBLEM],
                "export it again",
            ) from None
    return cameras


def _open(path: Path) -> Content:
    """Find out what kind of file one is."""
    try:
        encoding = find_encoding(path)
    except InputError:  # zeros as no text has them
        return Content(path, "binary")
    with path.open(encoding=encoding, errors="replace") as file:
        head = file.read(_HEAD).removeprefix("\ufeff")
    begin = head.lstrip()[:1]
    if begin == "<":
        return Content(path, "XML", encoding, head)
    if not begin or begin not in "{[":
        return Content(path, "text", encoding, head)
    size = path.stat().st_size
    if size > _LARGEST_JSON:
        raise InputError(
            f"{path}: is JSON of {size} bytes, more than {_LARGEST_JSON}",
            "export the cameras without the points",
        )
    text = path.read_bytes()
    if encoding != "utf-8":
        text = text.decode(encoding, "replace").encode()
    try:
        objects = split_json(text.removeprefix(b"\xef\xbb\xbf"))
    except ValueError as error:
        raise InputError(f"{path}: begins as JSON does, but {error}", "export it again") from None
    return Content(path, "JSON", encoding, head, tuple(objects))


def _refuse_other(content: Content) -> None:
    """Refuse what is neither a camera file nor may be a trajectory."""
    if content.kind == "text":
        part = find_colmap_part(content.head)
        if part is not None:
            raise InputError(
                f"{content.path}: is {part} of COLMAP, which does not say where the cameras were",
                f"name {' or '.join(_IN_FOLDER)} beside it, or their folder",
            )
        return
    names = [f.name for f in FORMATS if f.kind == content.kind]
    raise InputError(
        f"{content.path}: is {content.kind}, but none of {', '.join(names)}",
        "give one of these, a trajectory (.csv, .txt), or places as X,Y,Z",
    )


def _check(cameras: FloatArray) -> None:
    """Refuse places that are none, and a file without cameras."""
    if not len(cameras):
        raise ValueError("it has no camera with a pose")
    is_place = (np.abs(cameras) <= FARTHEST).all(axis=1)
    if not is_place.all():
        row = int(np.argmin(is_place))
        raise ValueError(f"camera {row + 1} is at no place: {cameras[row, :3].tolist()}")


def spread_places(cameras: FloatArray) -> FloatArray:
    """Return so few cameras, each as far as can be from those before it."""
    if len(cameras) <= MOST_PLACES:
        return cameras
    chosen, apart = [0], np.full(len(cameras), np.inf)
    while len(chosen) < MOST_PLACES:
        arms = cameras[:, :3] - cameras[chosen[-1], :3]
        apart = np.minimum(apart, np.einsum("ni,ni->n", arms, arms))
        chosen.append(int(np.argmax(apart)))
    return cameras.take(np.sort(chosen), axis=0)
