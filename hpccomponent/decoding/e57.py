"""Decode points of an E57 file.

``open SCAN ROWS FIELD ...`` begins with the points of a scan; ``next`` decodes up to so many rows
of it, and says how many. Each field fills its rows of the memory, as float64, one after the other.
"""

from __future__ import annotations

import os
import sys

from hpccomponent.decoding.serving import serve

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from hpccomponent.decoding.serving import Answer


def main() -> None:
    """Serve the process that has started this one."""
    serve(_open)


def _open(path: str, memory: memoryview, arguments: list[str]) -> Answer:  # noqa: ARG001
    library = _import_library()
    image = library.ImageFile(os.fsencode(path), "r")
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
    package = type(sys)("pye57")
    package.__path__ = [os.path.join(folder, "pye57") for folder in sys.path]
    sys.modules["pye57"] = package
    import pye57.libe57

    return pye57.libe57
