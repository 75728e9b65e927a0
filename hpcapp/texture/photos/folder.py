"""Photographs in a folder, and the cameras that have made them."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

from hpcapp.io.cameras.formats import find_camera_file, read_cameras
from hpcapp.io.cameras.poses import Camera
from hpcapp.texture.request import Photo
from hpcapp.wording import say_count
from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import InputError, UsageError

log = logging.getLogger("hpcapp")

_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp")


def find_photos(folder: str, viewpoints: Sequence[str]) -> tuple[Photo, ...]:
    """Return the photographs in a folder of the cameras that the words of ``--viewpoint`` name.

    Those that are missing, or of which no lens is known, are counted in a warning. Raise UsageError
    where no file of cameras is named, InputError where none of its photographs is in the folder.
    """
    shown = name_option("images", folder)
    if not Path(folder).is_dir():
        raise UsageError(f"{shown}: is no folder", "name the folder of the photographs")
    files = [path for word in viewpoints if (path := Path(word)).is_file() or path.is_dir()]
    known = [read_cameras(find_camera_file(path)) for path in files]
    cameras = [camera for some in known if some is not None for camera in some]
    if not cameras:
        raise UsageError(
            f"{shown}: no file says which cameras have made the photographs",
            f"name it, too: {name_option('viewpoint', 'sparse/0')}",
        )
    named = [camera for camera in cameras if camera.name]
    if not named:
        raise InputError(
            f"{files[0]}: its cameras do not name their photographs",
            "put list.txt beside a bundle.out, or export the cameras in another format",
        )
    return _match(folder, files[0], named)


def _match(folder: str, source: Path, cameras: Sequence[Camera]) -> tuple[Photo, ...]:
    """Return the photographs of cameras, and warn of those that there are not."""
    shown = name_option("images", folder)
    found, missing, unknown = [], [], []
    index = _index(Path(folder))
    for camera in cameras:
        path = next((index[name] for name in _list_tails(camera.name) if index.get(name)), None)
        if path is None:
            missing.append(camera)
        elif camera.lens is None:
            unknown.append(camera)
        else:
            found.append(Photo(path, camera, camera.lens.fit(*_find_size(path, camera))))
    first = (missing or unknown or cameras)[0].name[:100]
    if not found and len(unknown) >= len(missing):
        raise InputError(
            f"{source}: it tells no lens that is known here, as of {first}",
            "put cameras.txt or cameras.bin beside the images of COLMAP, or undistort them first",
        )
    if not found:
        raise InputError(
            f"{shown}: has none of {say_count(len(cameras), 'photograph')} that {source} names, "
            f"such as {first}",
            "name the folder of the photographs that were aligned",
        )
    count = say_count(len(cameras), "photograph")
    for others, what in ((missing, "are not in it"), (unknown, "have lenses unknown here")):
        if others:
            words = f"{len(others)} of {count} {what}, such as {others[0].name[:100]}"
            log.warning("warning: %s: %s", shown, words)
    return tuple(found)


def _find_size(path: Path, camera: Camera) -> tuple[int, int]:
    """Return width and height of a photograph; InputError where it is none of that camera."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            width, height = image.size
        assert camera.lens is not None  # noqa: S101 - or nobody would ask
        camera.lens.fit(width, height)
    except (OSError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: cannot be read: {error}", "copy it again") from None
    except ValueError as error:
        raise InputError(
            f"{path}: {error}", "give the photographs that were aligned, not turned and not cut"
        ) from None
    return width, height


def _index(folder: Path) -> dict[str, Path | None]:
    """Return the photographs of a folder by all names they may have; None where two have it."""
    index: dict[str, Path | None] = {}
    for path in sorted(_list_photos(folder)):
        for name in _list_tails(path.relative_to(folder).as_posix()):
            index[name] = None if name in index else path
    return index


def _list_photos(folder: Path) -> Iterator[Path]:
    for place, _, names in os.walk(folder):
        yield from (Path(place, name) for name in names if name.lower().endswith(_SUFFIXES))


def _list_tails(name: str) -> Iterator[str]:
    """Yield the ends of a path, the longest first, each with its suffix and without it.

    Examples
    --------
    >>> list(_list_tails("Left/1.JPG"))
    ['left/1.jpg', 'left/1', '1.jpg', '1']
    """
    parts = PurePosixPath(name.replace("\\", "/").lower()).parts
    for first in range(len(parts)):
        tail = PurePosixPath(*parts[first:])
        yield str(tail)
        if tail.suffix in _SUFFIXES:
            yield str(tail.with_suffix(""))
