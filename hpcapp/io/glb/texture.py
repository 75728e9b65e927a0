"""The texture of a GLB: where it lies on the vertices, and its pictures in the file.

::

    mesh │ places of the vertices │ tangents │ colours as JPEG │ normals as JPEG
"""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np

from hpcapp.geometry.points import ByteArray
from hpcapp.io.meshes.texture import Texture

_FLOAT, _VERTICES = 5126, 34962
_SMOOTH, _MIPMAPS, _ENDS = 9729, 9987, 33071
_QUALITY = 90
"""Of JPEG: below, its blocks show in the shading; above, a picture of 4096 exceeds 5 MB."""


def add_texture(document: dict[str, Any], texture: Texture) -> list[bytes]:
    """Add a texture to the JSON of a GLB with one mesh.

    Return what comes behind the body of the mesh; each is a multiple of 4 bytes.
    """
    body: list[bytes] = []
    (primitive,) = document["meshes"][0]["primitives"]
    rows = {"TEXCOORD_0": ("VEC2", texture.places), "TANGENT": ("VEC4", texture.tangents)}
    for semantic, (shape, values) in rows.items():
        primitive["attributes"][semantic] = len(document["accessors"])
        view = _add_view(document, body, np.ascontiguousarray(values, "<f4").tobytes())
        document["bufferViews"][view]["target"] = _VERTICES
        document["accessors"].append(
            {"bufferView": view, "componentType": _FLOAT, "count": len(values), "type": shape}
        )
    (material,) = document["materials"]
    document |= {"images": [], "textures": []}
    for picture, owner, name, title in (
        (texture.colours, material["pbrMetallicRoughness"], "baseColorTexture", "colours"),
        (texture.normals, material, "normalTexture", "normals"),
    ):
        if picture is not None:
            number = len(document["images"])
            view = _add_view(document, body, _encode(picture))
            document["images"].append({"name": title, "bufferView": view, "mimeType": "image/jpeg"})
            document["textures"].append({"name": title, "source": number, "sampler": 0})
            owner[name] = {"index": number}
    sampler = {"magFilter": _SMOOTH, "minFilter": _MIPMAPS, "wrapS": _ENDS, "wrapT": _ENDS}
    document["samplers"] = [sampler]
    return body


def _add_view(document: dict[str, Any], body: list[bytes], content: bytes) -> int:
    """Put bytes behind all others, and return the number of their view."""
    (buffer,) = document["buffers"]
    view = {"buffer": 0, "byteOffset": buffer["byteLength"], "byteLength": len(content)}
    body.append(content + bytes(-len(content) % 4))
    buffer["byteLength"] += len(body[-1])
    document["bufferViews"].append(view)
    return len(document["bufferViews"]) - 1


def _encode(picture: ByteArray) -> bytes:
    """Return a picture as JPEG, whose three channels are all as fine."""
    from PIL import Image

    encoded = BytesIO()
    Image.fromarray(picture).save(encoded, "JPEG", quality=_QUALITY, subsampling=0)
    return encoded.getvalue()
