"""What may be asked of a texture.

This module is imported for every ``--help``: nothing heavy is imported.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hpcapp.extras import require_library
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from hpcapp.io.cameras.lens import Lens
    from hpcapp.io.cameras.poses import Camera

LEAST_PIXELS, MOST_PIXELS = 256, 8192
"""Along a side: below, the gaps between charts take most of it; above, pictures have 200 MB."""

MOST_FACES = 200_000
"""Triangles that are unwrapped: they take a minute, and more take longer than in proportion."""


@dataclass(frozen=True, slots=True, eq=False)
class Photo:
    """A photograph that can be read, its camera, and the lens as it is in this size."""

    path: Path
    camera: Camera
    lens: Lens


def check_texture(output: str, faces: int | None, size: str | None) -> None:
    """Find out before the work whether a texture can come of what is asked for.

    The mesh is simplified to so many faces, or to a size. Raise UsageError where it is not to be
    light enough, or the output, as typed, does not hold a texture.
    """
    from hpcapp.io.formats import check_holds_texture

    check_holds_texture(output)
    if faces is None or faces > MOST_FACES:
        raise UsageError("--texture is for a light mesh", f"give --faces up to {MOST_FACES}")
    if size is not None:
        raise UsageError("--texture and --size exclude each other", "give --faces")


def check_images(images: str | None, texture: int | None) -> None:
    """Raise UsageError where there are photographs and no texture to take their colours."""
    if images is not None and texture is None:
        raise UsageError("--images means nothing without --texture", "give --texture 4096, too")


def check_library() -> None:
    """Raise MissingLibraryError where nothing is here that makes an atlas."""
    require_library("xatlas", "--texture needs the package xatlas", "texture")
