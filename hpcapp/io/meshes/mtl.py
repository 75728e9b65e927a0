"""The material of an OBJ: an MTL file and pictures beside it."""

from __future__ import annotations

from pathlib import Path

from hpcapp.geometry.points import ByteArray
from hpcapp.io.meshes.texture import Texture
from hpcapp.io.staging import replacing

_NAME = "surface"


def write_material(path: Path, texture: Texture) -> list[bytes]:
    """Write the material of an OBJ beside it.

    Parameters
    ----------
    path : Path
        Of the OBJ. Blanks in its name, at which readers end the names of others, become
        underscores.

    Returns
    -------
    list of bytes
        The lines of the OBJ that name it.

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    stem = "_".join(path.stem.split())
    lines = [f"newmtl {_NAME}", "Ka 0 0 0", "Kd 1 1 1", "Ks 0 0 0", "illum 1"]
    for picture, keyword, kind in (
        (texture.colours, "map_Kd", "colours"),
        (texture.normals, "norm", "normals"),
    ):
        if picture is not None:
            file = path.with_name(f"{stem}_{kind}.png")
            _write_picture(file, picture)
            lines.append(f"{keyword} {file.name}")
    material = path.with_name(f"{stem}.mtl")
    with replacing(material) as written:
        written.write(("\n".join(lines) + "\n").encode())
    return [f"mtllib {material.name}\n".encode(), f"usemtl {_NAME}\n".encode()]


def _write_picture(path: Path, picture: ByteArray) -> None:
    from PIL import Image

    with replacing(path) as file:
        Image.fromarray(picture).save(file, "PNG")
