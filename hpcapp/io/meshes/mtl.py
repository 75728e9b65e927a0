"""The material of an OBJ: an MTL file and pictures beside it.

Each is named after the OBJ, one to one: ``a b.obj`` has ``a~20b.mtl``, and ``a_b.obj`` ``a_b.mtl``.
"""

from __future__ import annotations

import os
from pathlib import Path

from hpcapp.geometry.points import ByteArray
from hpcapp.io.meshes.texture import Texture
from hpcapp.io.staging import replacing

_NAME = "surface"
_ORDERS = " ~#%?\\\"'"
"""What ends a name or is an order in some reader of MTL, or in the address of a web viewer; and
what writes these out."""


def name_texture_files(path: Path) -> tuple[Path, Path, Path]:
    """Return the files beside an OBJ that hold its texture: material, colours, normals."""
    stem = "".join(map(_write_out, path.stem))
    stem = f"~2d{stem[1:]}" if stem.startswith("-") else stem  # else it is an option of map_Kd
    is_upper = [letter.isupper() for letter in path.suffix]  # a.obj and a.OBJ are two

    def name(end: str, suffix: str) -> Path:
        letters = zip(suffix, is_upper, strict=True)
        return path.with_name(stem + end + "".join(a.upper() if up else a for a, up in letters))

    return name("", ".mtl"), name("_colours", ".png"), name("_normals", ".png")


def _write_out(letter: str) -> str:
    """Return a character of a name as any reader takes it."""
    if letter.isprintable() and letter not in _ORDERS:
        return letter
    return "".join(f"~{byte:02x}" for byte in os.fsencode(letter))


def write_material(path: Path, texture: Texture) -> list[bytes]:
    """Write the material of an OBJ beside it, and return the lines of the OBJ that name it.

    Raise OutputError where a file cannot be written.
    """
    material, colours, normals = name_texture_files(path)
    lines = [f"newmtl {_NAME}", "Ka 0 0 0", "Kd 1 1 1", "Ks 0 0 0", "illum 1"]
    for picture, keyword, file in (
        (texture.colours, "map_Kd", colours),
        (texture.normals, "norm", normals),
    ):
        if picture is not None:
            _write_picture(file, picture)
            lines.append(f"{keyword} {file.name}")
    with replacing(material) as written:
        written.write(("\n".join(lines) + "\n").encode())
    return [f"mtllib {material.name}\n".encode(), f"usemtl {_NAME}\n".encode()]


def _write_picture(path: Path, picture: ByteArray) -> None:
    from PIL import Image

    with replacing(path) as file:
        Image.fromarray(picture).save(file, "PNG")
