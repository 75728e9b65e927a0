"""The JSON of a glTF 2.0, as far as its triangles need it: every number of the type it should be.

Indices are looked up by `pick` alone: any may lead nowhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, TypeVar

import msgspec

from hpccomponent.foreign_json import decode_large

T = TypeVar("T")

_Whole = Annotated[int, msgspec.Meta(ge=0)]
_Vector = tuple[float, float, float]
_Matrix = Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]

_NOTHING = msgspec.Raw(b"")

MEMORY = 32
"""Bytes that a byte of JSON takes here, at most: of nodes ``{}``, 3 bytes each."""


class Accessor(msgspec.Struct, rename="camel"):
    """Rows of numbers in a view."""

    component_type: int
    count: _Whole
    type: str
    buffer_view: int | None = None
    byte_offset: _Whole = 0
    normalized: bool = False
    sparse: msgspec.Raw = _NOTHING

    @property
    def is_sparse(self) -> bool:
        """Whether some of its rows are elsewhere."""
        return len(self.sparse) > 0


class View(msgspec.Struct, rename="camel"):
    """Bytes of a buffer."""

    buffer: int
    byte_length: _Whole
    byte_offset: _Whole = 0
    byte_stride: _Whole | None = None


class Buffer(msgspec.Struct):
    """Bytes of the file, unless they are elsewhere."""

    uri: msgspec.Raw = _NOTHING

    @property
    def has_uri(self) -> bool:
        """Whether they are elsewhere."""
        return len(self.uri) > 0


class Primitive(msgspec.Struct):
    """Triangles, in mode 4; the accessors of their columns by semantic, and of their corners."""

    attributes: dict[str, int]
    indices: int | None = None
    mode: int = 4


class MeshPrimitives(msgspec.Struct):
    """Primitives that are placed together."""

    primitives: list[Primitive]
    extras: msgspec.Raw = _NOTHING


class Node(msgspec.Struct):
    """A place, and what is there."""

    children: list[int] = []
    mesh: int | None = None
    matrix: _Matrix | None = None
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    scale: _Vector = (1.0, 1.0, 1.0)
    translation: _Vector = (0.0, 0.0, 0.0)
    extras: msgspec.Raw = _NOTHING


class GlbScene(msgspec.Struct):
    """Nodes that are in no other."""

    nodes: list[int] = []


class Document(msgspec.Struct, rename="camel"):
    """What is in a file."""

    accessors: list[Accessor] = []
    buffer_views: list[View] = []
    buffers: list[Buffer] = []
    meshes: list[MeshPrimitives] = []
    nodes: list[Node] = []
    scenes: list[GlbScene] = []
    scene: int = 0
    extensions_required: list[str] = []


class MeshExtras(msgspec.Struct):
    """What `write_glb` says in a mesh: semantics of attributes, and what was subtracted of them."""

    attributes: dict[str, str] = {}
    offsets: dict[str, float] = {}


class NodeExtras(msgspec.Struct):
    """What `write_glb` says in a node: the axis that was up."""

    up: str = ""


def pick(rows: Sequence[T], index: int, what: str) -> T:
    """Return one of some rows; IndexError where there is none of that number."""
    if not 0 <= index < len(rows):
        raise IndexError(f"there is no {what} {index}")
    return rows[index]


def read_extras(extras: msgspec.Raw, kind: type[T]) -> T:
    """Return what `write_glb` says in extras; nothing where another program has said something."""
    try:
        return decode_large(extras, kind)
    except ValueError:
        return kind()
