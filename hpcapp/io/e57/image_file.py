"""The border to libE57: its files, its nodes, its errors."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from hpccomponent.errors import InputError, UsageError

__all__ = ["find_number", "load_library", "numeric_fields", "open_image"]


def load_library(path: Path) -> Any:
    """Import the binding of libE57.

    Parameters
    ----------
    path : Path
        The file it is needed for, for the message.

    Returns
    -------
    module
        ``pye57.libe57``.

    Raises
    ------
    UsageError
        It is not installed.
    """
    try:
        return import_module("pye57.libe57")
    except ImportError as error:
        raise UsageError(
            f"{path}: E57 needs the package pye57", "pip install 'hpcapp[e57]'"
        ) from error


@contextmanager
def open_image(path: Path) -> Iterator[Any]:
    """Open an E57 file to read it.

    Parameters
    ----------
    path : Path

    Yields
    ------
    libe57.ImageFile
        Closed after the block.

    Raises
    ------
    InputError
        libE57 gave up, here or in the block: the file is damaged.
    UsageError
        It is not installed.
    OSError
        The file cannot be opened.
    """
    library = load_library(path)
    path.open("rb").close()  # the system's errors are clearer
    try:
        image = library.ImageFile(os.fsencode(path), "r")
        try:
            yield image
        finally:
            if image.isOpen():
                image.close()
    except library.E57Exception as error:
        why = str(error).partition("\n")[0]
        raise InputError(
            f"{path}: is no sound E57 file: {why}", "copy or export the file again"
        ) from error


def numeric_fields(library: Any, points: Any) -> dict[str, Any]:
    """Return the fields of a scan's points that are numbers.

    Parameters
    ----------
    library : module
        ``pye57.libe57``.
    points : libe57.CompressedVectorNode

    Returns
    -------
    dict of str to node
        By name, in the order of the file.
    """
    casts = {
        library.NodeType.E57_FLOAT: library.FloatNode,
        library.NodeType.E57_INTEGER: library.IntegerNode,
        library.NodeType.E57_SCALED_INTEGER: library.ScaledIntegerNode,
    }
    prototype = library.StructureNode(points.prototype())
    nodes = [prototype.get(i) for i in range(prototype.childCount())]
    return {node.elementName(): casts[node.type()](node) for node in nodes if node.type() in casts}


def find_number(node: Any, *path: str) -> float | None:
    """Return the number at a place below a node.

    Parameters
    ----------
    node : libe57.StructureNode
    *path : str
        Names of nodes, each below the one before.

    Returns
    -------
    float or None
        None where there is none.
    """
    for name in path:
        if not hasattr(node, "isDefined") or not node.isDefined(name):
            return None
        node = node[name]
    for method in ("scaledValue", "value"):
        if hasattr(node, method):
            value = getattr(node, method)()
            return float(value) if isinstance(value, int | float) else None
    return None
