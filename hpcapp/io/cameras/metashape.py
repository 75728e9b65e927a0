"""Metashape's cameras as XML: poses from camera to chunk, and from chunk to world.

The chunk has its transform itself, or each of its components has one; without one the chunk's
coordinates are the world's.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.cameras.poses import FORWARDS, camera_to_world, check_rotations
from hpccomponent.dataclass import dataclass

_LONGEST_TEXT = 4096  # characters of 16 numbers
_DEEPEST = 64  # elements within each other
_AT_ONCE = 1 << 20

Numbers = dict[str, list[float]]
"""What a transform says: the numbers of its rotation, translation and scale."""


@dataclass(slots=True)
class _Chunk:
    """The poses of a chunk, by the component that each is of; of the chunk itself by ``""``."""

    poses: dict[str, list[FloatArray]] = field(default_factory=lambda: defaultdict(list))
    transforms: dict[str, Numbers] = field(default_factory=lambda: defaultdict(dict))

    def cameras(self) -> list[FloatArray]:
        """Return the cameras in the coordinates of the world, those of each component together."""
        own = self.transforms.get("", {})
        return [
            _move(camera_to_world(poses, FORWARDS), self.transforms.get(name, own))
            for name, poses in self.poses.items()
        ]


def read_metashape(path: Path) -> FloatArray:
    """Read the cameras that were aligned; the others have no transform.

    Raise ValueError where the XML is not sound, declares a document type, or has words where
    numbers belong.
    """
    parser = _TransformParser()
    with path.open("rb") as file:
        while part := file.read(_AT_ONCE):
            parser.feed(part)
        parser.feed(b"", is_last=True)
    cameras = [some for chunk in parser.chunks for some in chunk.cameras()]
    return np.concatenate([np.empty((0, 6)), *cameras])


class _TransformParser:
    """Keeps the transforms of cameras, chunks and components, and nothing else."""

    def __init__(self) -> None:
        self.chunks: list[_Chunk] = []
        self._open: list[str] = []
        self._component = ""
        self._text: str | None = None
        self._parser = expat.ParserCreate()
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._add_text
        self._parser.StartDoctypeDeclHandler = self._refuse_declarations

    def feed(self, part: bytes, *, is_last: bool = False) -> None:
        try:
            self._parser.Parse(part, is_last)
        except (expat.ExpatError, LookupError) as error:  # the latter: encodings
            raise ValueError(f"its XML: {error}") from None

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._open.append(name)
        if len(self._open) > _DEEPEST:
            raise ValueError(f"its XML has more than {_DEEPEST} elements within each other")
        if name == "chunk":
            self.chunks.append(_Chunk())
        if name in ("camera", "component"):
            self._component = attributes.get("component_id" if name == "camera" else "id", "")
        if self.chunks and self._is_wanted():
            self._text = ""

    def _is_wanted(self) -> bool:
        match self._open:
            case [*_, "camera", "transform"]:
                return True
            case [*_, "chunk" | "component", "transform", "rotation" | "translation" | "scale"]:
                return True
        return False

    def _end(self, name: str) -> None:
        if self._text is not None and self._is_wanted():
            numbers, chunk = [float(word) for word in self._text.split()], self.chunks[-1]
            if name == "transform":
                chunk.poses[self._component].append(_shape(name, numbers, 4, 4))
            else:
                of_chunk = self._open[-3] == "chunk"
                chunk.transforms["" if of_chunk else self._component][name] = numbers
            self._text = None
        self._open.pop()

    def _add_text(self, text: str) -> None:
        if self._text is not None:
            self._text += text
            if len(self._text) > _LONGEST_TEXT:
                raise ValueError(f"the {self._open[-1]} has more than {_LONGEST_TEXT} characters")

    def _refuse_declarations(self, *declared: object) -> NoReturn:  # noqa: ARG002
        raise ValueError("its XML declares a document type")


def _move(cameras: FloatArray, transform: Numbers) -> FloatArray:
    """Take cameras from their chunk to the world."""
    rotation = _shape("rotation", transform.get("rotation", np.eye(3).ravel().tolist()), 3, 3)
    translation = _shape("translation", transform.get("translation", [0.0, 0.0, 0.0]), 3)
    scale = float(_shape("scale", transform.get("scale", [1.0]), 1)[0])
    check_rotations(rotation[None])
    if not scale > 0.0:
        raise ValueError(f"the scale of its chunk is {scale:g}")
    with np.errstate(over="ignore", invalid="ignore"):
        centres = scale * cameras[:, :3] @ rotation.T + translation
    return np.concatenate([centres, cameras[:, 3:] @ rotation.T], axis=1)


def _shape(name: str, numbers: list[float], *shape: int) -> FloatArray:
    """Return numbers as an array; ValueError where there are more or less of them."""
    if len(numbers) != np.prod(shape):
        raise ValueError(f"a {name} has {len(numbers)} numbers, not {np.prod(shape)}")
    return np.array(numbers).reshape(shape)
