"""3MF: a ZIP file of XML, for printers and slicers; triangles with the colours of their corners.

::

    [Content_Types].xml │ _rels/.rels │ 3D/3dmodel.model: one object, one item that places it

https://github.com/3MFConsortium/spec_core, https://github.com/3MFConsortium/spec_materials
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO
from xml.sax.saxutils import escape
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import IntArray
from hpcapp.io.crs import METRES, Crs
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.rows import write_rows
from hpcapp.io.staging import replacing

_TYPES = b"""<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
_LINKS = b"""<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" \
Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""
_BEGIN = """<?xml version="1.0" encoding="UTF-8"?>
<model unit="{}" xml:lang="en-US" \
xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" \
xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02">
<metadata name="Application">hpcapp</metadata>
{}<resources>
"""
_END = """</mesh></object>
</resources>
<build><item objectid="1"{}/></build>
</model>
"""
_UNITS = {"m": "meter", "ft": "foot", "mm": "millimeter", "cm": "centimeter"}


def write_3mf(path: Path, mesh: Mesh | MeshStream) -> None:
    """Write a triangle mesh as 3MF.

    Vertices have nine digits; what is left of the origin is the translation of the build item. The
    unit is that of the input, millimetres where it states none; one that 3MF does not know is
    scaled to metres by the build item, and so are heights of another one. Colours are those of the
    triangles' corners, blended between them.
    """
    stream = as_stream(mesh)
    with replacing(path) as file, ZipFile(file, "w") as package:
        for name, text in (("[Content_Types].xml", _TYPES), ("_rels/.rels", _LINKS)):
            package.writestr(_entry(name), text)
        with package.open(_entry("3D/3dmodel.model"), "w", force_zip64=True) as model:
            _write_model(model, stream)


def _entry(name: str) -> ZipInfo:
    """Return an entry without today's date: the same mesh gives the same bytes."""
    entry = ZipInfo(name)
    entry.compress_type = ZIP_DEFLATED
    return entry


def _write_model(model: IO[bytes], stream: MeshStream) -> None:
    crs = stream.crs
    words = [crs.text] if crs.text else []
    words += [f"origin {stream.said['origin']}"] if stream.shift.any() else []
    text = escape(", ".join(words))
    described = f'<metadata name="Description">{text}</metadata>\n' if text else ""
    model.write(_BEGIN.format(_choose_unit(crs)[0], described).encode())
    palette: IntArray | None = None
    if stream.layout.colours is not None:
        palette = np.unique(np.concatenate([np.empty(0, np.int64), *_codes(stream)]))
        model.write(b'<m:colorgroup id="2">\n')
        rgb = np.stack([palette >> 16, palette >> 8 & 255, palette & 255], axis=1)
        model.writelines(write_rows('<m:color color="#%02X%02X%02X"/>\n', rgb))
        model.write(b"</m:colorgroup>\n")
    owner = b"" if palette is None else b' pid="2" pindex="0"'
    model.write(b'<object id="1" type="model"' + owner + b"><mesh><vertices>\n")
    for vertices in stream.vertices():
        row = '<vertex x="%.9g" y="%.9g" z="%.9g"/>\n'
        model.writelines(write_rows(row, vertices.positions))
    model.write(b"</vertices><triangles>\n")
    if palette is None:
        for faces in stream.faces():
            model.writelines(write_rows('<triangle v1="%d" v2="%d" v3="%d"/>\n', faces))
    else:
        colour = np.concatenate([np.searchsorted(palette, codes) for codes in _codes(stream)])
        row = '<triangle v1="%d" v2="%d" v3="%d" pid="2" p1="%d" p2="%d" p3="%d"/>\n'
        for faces in stream.faces():
            model.writelines(write_rows(row, np.hstack([faces, colour[faces]])))
    model.write(b"</triangles>")
    model.write(_END.format(_placement(stream)).encode())


def _codes(stream: MeshStream) -> Iterator[IntArray]:
    """Yield the colours of the vertices as one number each."""
    for vertices in stream.vertices():
        if vertices.colours is not None:
            yield vertices.colours.astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])


def _choose_unit(crs: Crs) -> tuple[str, float]:
    """Return the unit of a model, and how many of it that of the input is."""
    if crs.unit in _UNITS:
        return _UNITS[crs.unit], 1.0
    return ("meter", METRES[crs.unit]) if crs.unit in METRES else ("millimeter", 1.0)


def _placement(stream: MeshStream) -> str:
    """Return the attribute that moves the object to its origin, and scales it to its unit."""
    _, scale = _choose_unit(stream.crs)
    scales = scale * np.array([1.0, 1.0, stream.crs.height_scale])
    if not stream.origin.any() and (scales == 1.0).all():
        return ""
    numbers = [*np.diag(scales).ravel(), *(stream.origin * scales)]
    return f' transform="{" ".join(f"{value:.17g}" for value in numbers)}"'
