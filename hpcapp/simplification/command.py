"""The verb ``simplify``, and what verbs of a mesh share; imported for every ``--help``."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hpcapp.geometry.axis_names import AXES
from hpcapp.named_files import FILE_OR_WORD, SCAN
from hpcapp.named_files import MESH as MESH_FILE
from hpcapp.parts.crop import Crop
from hpcapp.parts.options import PLACE, cropped
from hpcapp.texture.request import (
    LEAST_PIXELS,
    MOST_PIXELS,
    check_images,
    check_library,
    check_texture,
)
from hpccomponent.cli.verb import Verb
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from hpcapp.geometry.mesh import Mesh
    from hpcapp.io.crs import Crs
    from hpcapp.texture.request import Photo

log = logging.getLogger("hpcapp")

ORIGIN = click.option(
    "--origin",
    default="auto",
    show_default=True,
    metavar="WHERE",
    help="What is subtracted from the coordinates: auto, in .glb, .obj, .stl and .3mf what makes "
    "those of a map fit single precision; keep, nothing; or X,Y,Z. A file beside MESH, "
    ".origin.json, brings it back.",
)
UP = click.option(
    "--up",
    type=click.Choice(AXES),
    help="The axis that points up, for .glb and .3dtiles.  [default: z, or y of what stands on a "
    "flat base there]",
)


MESH = click.argument(
    "mesh",
    type=SCAN,
    help="A .ply, .obj, .off, .stl, .glb or .vtp.",
)
_OUTPUT = click.option(
    "-o",
    "--output",
    required=True,
    type=MESH_FILE,
    metavar="MESH",
    help="Mesh to write: .ply, .obj, .glb, .vtp, .3mf, .off, .stl, .tiles or .3dtiles; - writes a "
    "PLY to standard output.",
)
_FACES = click.option(
    "--faces", type=click.IntRange(4), metavar="N", help="Simplify it to N triangles."
)
_TOLERANCE = click.option(
    "--tolerance",
    type=click.FloatRange(0, min_open=True),
    metavar="LENGTH",
    help="Simplify it while its surface moves by less, in its own units.",
)
_ATTRIBUTES = click.option(
    "--attributes",
    default="auto",
    show_default=True,
    metavar="NAMES",
    help="What of its vertices stays: auto (all), none, or names as normals,colours,c.",
)
_SIZE = click.option("--size", metavar="BYTES", help="Simplify it to a file of at most that: 20MB.")
_TEXTURE = click.option(
    "--texture",
    type=click.IntRange(LEAST_PIXELS, MOST_PIXELS),
    metavar="PIXELS",
    help="With --faces: bake colours and normals of the mesh as it was into a picture of so many "
    "pixels a side, in a .glb or beside an .obj.",
)
_IMAGES = click.option(
    "--images",
    type=FILE_OR_WORD,
    metavar="FOLDER",
    help="With --texture: take the colours from the photographs in a folder, whose cameras "
    "--viewpoint names.",
)
_VIEWPOINT = click.option(
    "--viewpoint",
    type=FILE_OR_WORD,
    multiple=True,
    metavar="CAMERAS",
    help="With --images: a file of cameras (COLMAP, OpenDroneMap, Metashape and others), in the "
    "coordinates of the mesh; may be given several times.",
)


def with_output(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a verb the options of a mesh that is simplified and written: those of `Output`."""
    textured = (_VIEWPOINT, _IMAGES, _TEXTURE)
    for option in (UP, ORIGIN, *textured, _ATTRIBUTES, _SIZE, _TOLERANCE, _FACES, _OUTPUT):
        command = option(command)
    return command


@dataclass(frozen=True, slots=True)
class Output:
    """A mesh to write, as the options of `with_output` say."""

    output: str
    faces: int | None
    tolerance: float | None
    size: str | None
    attributes: str
    texture: int | None
    images: str | None
    viewpoint: tuple[str, ...]
    origin: str
    up: str | None

    @property
    def is_light(self) -> bool:
        """Whether it is to be simplified."""
        return any(one is not None for one in (self.faces, self.tolerance, self.size))

    @property
    def is_placed(self) -> bool:
        """Whether it is to be turned or moved."""
        return self.up is not None or self.origin != "auto"

    @property
    def is_bare(self) -> bool:
        """Whether something of its vertices is to be left out."""
        return self.attributes != "auto"

    def write(
        self,
        mesh: Path,
        change: Callable[[Mesh, Crs], Mesh],
        finish: Callable[[Mesh, Crs, str | None], tuple[Mesh, Crs]] | None = None,
    ) -> tuple[Mesh, Mesh]:
        """Read a mesh, change, simplify, finish and write it; return it as read, and as written.

        To finish is to bring it into other coordinates with z up, given the axis that is known to
        point up.
        """
        from dataclasses import replace

        from hpcapp.applications.surface.attributes.choice import parse_attributes
        from hpcapp.io import find_mesh_crs, find_mesh_up, read_mesh, write_mesh
        from hpcapp.io.meshes.mesh_stream import as_stream
        from hpcapp.io.output import open_output
        from hpcapp.io.placement import Placement, parse_origin
        from hpcapp.simplification.mesh import simplify_mesh
        from hpcapp.simplification.size import fit_mesh, read_size
        from hpcapp.simplification.target import Target

        target = Target(self.faces, self.tolerance)
        target.check()
        photos = self._find_photos()
        origin, choice = parse_origin(self.origin), parse_attributes(self.attributes)
        most_bytes = None if self.size is None else read_size(self.size, self.output)
        with open_output(self.output) as path:
            whole = choice.select_of_mesh(read_mesh(mesh), str(mesh))
            crs = find_mesh_crs(mesh)
            placement = Placement(origin, self.up or find_mesh_up(mesh))
            changed = change(whole, crs)
            light = simplify_mesh(changed, target)
            if most_bytes is not None:
                light = fit_mesh(light, most_bytes, path.suffix, crs, placement, choice.named)
            if finish is not None:
                (light, crs), placement = finish(light, crs, placement.up), Placement(up="z")
            stream = as_stream(light)
            if self.texture is not None:
                from hpcapp.texture.of_mesh import texture_mesh

                stream = texture_mesh(light, changed, self.texture, photos)
            write_mesh(path, replace(stream, crs=crs), placement)
        is_bound = self.faces is not None and self.tolerance is None
        if is_bound and len(light.faces) > (self.faces or 0):
            log.warning("warning: %d faces are left: fewer would break the mesh", len(light.faces))
        return whole, light

    def _find_photos(self) -> tuple[Photo, ...]:
        """Return the photographs that are asked for; UsageError where no texture can come of it."""
        check_images(self.images, self.texture)
        if self.viewpoint and self.images is None:
            raise UsageError("--viewpoint means nothing without --images", "give --images, too")
        if self.texture is None:
            return ()
        check_texture(self.output, self.faces, self.size)
        check_library()
        if self.images is None:
            return ()
        from hpcapp.texture.photos.folder import find_photos

        return find_photos(self.images, self.viewpoint)


@click.command(
    cls=Verb,
    examples=[
        (
            "hpcapp simplify mesh.ply -o light.glb --faces 50000",
            "Leave 50,000 triangles, for a viewer.",
        ),
        (
            "hpcapp simplify mesh.ply -o light.ply --tolerance 0.002",
            "Leave what keeps the surface within 0.002 of where it is.",
        ),
        (
            "hpcapp simplify mesh.ply -o light.glb --size 20MB",
            "Leave as many triangles as a file of 20 MB holds.",
        ),
    ],
)
@MESH
@cropped(*PLACE)
@with_output
def simplify(mesh: Path, crop: Crop, **options: Any) -> None:
    """Simplify a mesh, or a part, with all that its vertices carry."""
    output = Output(**options)
    if not (output.is_light or output.is_bare or crop.has_region):
        raise UsageError("nothing to simplify to", "give --faces, --tolerance or --size")
    whole, light = output.write(
        mesh, lambda whole, crs: crop.cut(whole, crs.height_scale, str(mesh))
    )
    log.info("%s: %d of %d faces", output.output, len(light.faces), len(whole.faces))
