"""Decode points of an E57 file.

``open SCAN ROWS FIELD ...`` begins with the points of a scan; ``next`` decodes up to so many rows
of it, and says how many. Each field fills its rows of the memory, as float64, one after the other.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

from hpccomponent.decoding.serving import Answer, serve


def _open(path: str, memory: memoryview, arguments: list[str]) -> Answer:  # noqa: ARG001
    library = _import_library()
    image = library.ImageFile(path, "r")
    numbers = memory[: len(memory) // 8 * 8].cast("d")
    reader: Any = None

    def answer(request: list[str]) -> int:
        nonlocal reader
        verb, *words = request
        if verb == "next":
            return int(reader.read())
        if reader is not None:
            reader.close()
        index, rows = int(words[0]), int(words[1])
        buffers = library.VectorSourceDestBuffer()
        for i, name in enumerate(words[2:]):
            column = numbers[i * rows : (i + 1) * rows]
            buffers.append(library.SourceDestBuffer(image, name, column, rows, True, True))
        reader = image.root()["data3D"][index]["points"].reader(buffers)
        return 0

    return answer


def _import_library() -> Any:
    """Import the extension alone: the package around it imports numpy, which takes far longer."""
    spec = find_spec("pye57")
    if spec is None or spec.submodule_search_locations is None:
        raise ImportError("E57 needs the package pye57")
    package = ModuleType("pye57")
    package.__path__ = list(spec.submodule_search_locations)
    sys.modules["pye57"] = package
    return import_module("pye57.libe57")


if __name__ == "__main__":
    serve(_open)
