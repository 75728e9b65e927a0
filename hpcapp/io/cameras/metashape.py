"""Metashape's cameras as XML: poses from camera to chunk, and from chunk to world.

The chunk has its transform itself, or each of its components has one; without one the chunk's
coordinates are the world's.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import field, replace
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.cameras.lens import Lens
from hpcapp.io.cameras.poses import FORWARDS, Camera, camera_to_world, check_rotations
from hpccomponent.dataclass import dataclass

_LONGEST_TEXT = 4096  # characters of 16 numbers
_DEEPEST = 64  # elements within each other
_AT_ONCE = 1 << 20

Numbers = dict[str, list[float]]
"""What a transform says: the numbers of its rotation, translation and scale."""
_CALIBRATED = ("f", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2")


@dataclass(slots=True)
class _Sensor:
    """What is said of a lens, the last of several calibrations, and the size of its pictures."""

    kind: str
    size: tuple[float, float] = (0.0, 0.0)
    numbers: dict[str, float] = field(default_factory=dict)

    def make_lens(self) -> Lens | None:
        """Return the lens, whose p1 and p2 stand the other way round in OpenCV."""
        f, cx, cy, k1, k2, k3, k4, p1, p2, b1, b2 = (self.numbers.get(n, 0.0) for n in _CALIBRATED)
        if self.kind not in ("frame", "fisheye") or not f > 0.0 or not f + b1 > 0.0:
            return None
        return Lens(
            self.size, (f + b1, f), (cx, cy), (k1, k2, k3, k4), (), (p2, p1), b2,
            is_fisheye=self.kind == "fisheye",
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Pose:
    matrix: FloatArray
    label: str
    sensor: str


@dataclass(slots=True)
class _Chunk:
    """The poses of a chunk, by the component that each is of; of the chunk itself by ``""``."""

    poses: dict[str, list[_Pose]] = field(default_factory=lambda: defaultdict(list))
    transforms: dict[str, Numbers] = field(default_factory=lambda: defaultdict(dict))
    sensors: dict[str, _Sensor] = field(default_factory=dict)

    def cameras(self) -> Iterator[Camera]:
        """Yield the cameras in the coordinates of the world, those of each component together."""
        own = self.transforms.get("", {})
        lenses = {name: sensor.make_lens() for name, sensor in self.sensors.items()}
        for name, poses in self.poses.items():
            cameras = camera_to_world(
                [pose.matrix for pose in poses], FORWARDS,
                [pose.label for pose in poses], [lenses.get(pose.sensor) for pose in poses],
            )  # fmt: skip
            yield from _move(cameras, self.transforms.get(name, own))


def read_metashape(path: Path) -> list[Camera]:
    """Read the cameras that were aligned; the others have no transform.

    Raise ValueError where the XML is not sound, declares a document type, or has words where
    numbers belong.
    """
    parser = _TransformParser()
    with path.open("rb") as file:
        while part := file.read(_AT_ONCE):
            parser.feed(part)
        parser.feed(b"", is_last=True)
    return [camera for chunk in parser.chunks for camera in chunk.cameras()]


class _TransformParser:
    """Keeps the transforms of cameras, chunks and components, lenses, and nothing else."""

    def __init__(self) -> None:
        self.chunks: list[_Chunk] = []
        self._open: list[str] = []
        self._component = ""
        self._label = self._sensor = ""
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
        if self.chunks:
            self._note(name, attributes)
        if self.chunks and self._is_wanted():
            self._text = ""

    def _note(self, name: str, attributes: dict[str, str]) -> None:
        """Keep what attributes say of lenses, and of the pictures of cameras."""
        sensors = self.chunks[-1].sensors
        if name == "camera":
            self._label, self._sensor = attributes.get("label", ""), attributes.get("sensor_id", "")
        elif name == "sensor":
            self._sensor = attributes.get("id", "")
            sensors[self._sensor] = _Sensor(attributes.get("type", "frame"))
        elif self._open[-2:] == ["sensor", "resolution"]:
            width, height = (float(attributes.get(side, "0")) for side in ("width", "height"))
            sensors[self._sensor].size = width, height
        elif self._open[-2:] == ["sensor", "calibration"]:
            sensors[self._sensor].numbers.clear()

    def _is_wanted(self) -> bool:
        match self._open:
            case [*_, "sensor", "calibration", one]:
                return one in _CALIBRATED
            case [*_, "camera", "transform"]:
                return True
            case [*_, "chunk" | "component", "transform", "rotation" | "translation" | "scale"]:
                return True
        return False

    def _end(self, name: str) -> None:
        if self._text is not None and self._is_wanted():
            numbers, chunk = [float(word) for word in self._text.split()], self.chunks[-1]
            if name == "transform":
                matrix = _shape(name, numbers, 4, 4)
                chunk.poses[self._component].append(_Pose(matrix, self._label, self._sensor))
            elif self._open[-2] == "calibration":
                chunk.sensors[self._sensor].numbers[name] = float(_shape(name, numbers, 1)[0])
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


def _move(cameras: list[Camera], transform: Numbers) -> Iterator[Camera]:
    """Take cameras from their chunk to the world."""
    rotation = _shape("rotation", transform.get("rotation", np.eye(3).ravel().tolist()), 3, 3)
    translation = _shape("translation", transform.get("translation", [0.0, 0.0, 0.0]), 3)
    scale = float(_shape("scale", transform.get("scale", [1.0]), 1)[0])
    check_rotations(rotation[None])
    if not scale > 0.0:
        raise ValueError(f"the scale of its chunk is {scale:g}")
    for camera in cameras:
        with np.errstate(over="ignore", invalid="ignore"):
            centre = scale * rotation @ camera.centre + translation
        yield replace(camera, centre=centre, rotation=camera.rotation @ rotation.T)


def _shape(name: str, numbers: list[float], *shape: int) -> FloatArray:
    """Return numbers as an array; ValueError where there are more or less of them."""
    if len(numbers) != np.prod(shape):
        raise ValueError(f"a {name} has {len(numbers)} numbers, not {np.prod(shape)}")
    return np.array(numbers).reshape(shape)
