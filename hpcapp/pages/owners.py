"""Which tile each vertex of a mesh is from and which worker made it: for pages, and for reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import IntArray
from hpcapp.pages.scene import Field, label_field
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError
from hpccomponent.foreign_json import convert

TILE = "hpcapp:tile"
"""The attribute of a mesh that says which tile each vertex is from, until `take_labels`."""

MOST_TILES = 1 << 16
"""That a page tells apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Owners:
    """Who made a mesh.

    Tiles (v,) are of each vertex, in the order of the mesh's file; workers are of each tile, empty
    where it is not known of all.
    """

    tiles: IntArray
    workers: Sequence[str] = ()

    def to_json(self) -> dict[str, object]:
        """Return it for a report: tiles by runs of vertices, of which there are few.

        Examples
        --------
        >>> Owners(np.array([1, 1, 0, 2]), ("a", "b", "a")).to_json()
        {'tiles': [1, 0, 2], 'vertices': [2, 1, 1], 'workers': ['a', 'b', 'a']}
        """
        starts = np.flatnonzero(np.diff(self.tiles, prepend=-1))
        counts = np.diff(starts, append=len(self.tiles))
        return {
            "tiles": self.tiles[starts].tolist(),
            "vertices": counts.tolist(),
            "workers": list(self.workers),
        }


@dataclass(frozen=True, slots=True)
class _OwnerRuns:
    """What `Owners.to_json` writes."""

    tiles: list[Annotated[int, Meta(ge=0, lt=1 << 31)]]
    vertices: list[Annotated[int, Meta(ge=0, lt=1 << 62)]]
    workers: list[str]


def mark_tiles(
    mesh: Mesh, path: Path, report: Mapping[str, object], source: str
) -> tuple[Mesh, Sequence[str]]:
    """Give a mesh that was read the attribute `TILE`, as the report of its job tells.

    The mesh is in the order of its file; an STL has none. The report has `Owners.to_json` as
    ``owners``; messages name its source. Return the mesh, as it is where nothing is told of it, or
    of one with other vertices, and each tile's worker as `Owners` has it. Raise InputError where
    what is told is nothing of the kind.
    """
    if "owners" not in report or path.suffix.lower() == ".stl":
        return mesh, ()
    try:
        runs = convert(report["owners"], _OwnerRuns)
        tiles, counts, workers = np.array(runs.tiles, np.int32), runs.vertices, runs.workers
        if len(counts) != len(tiles):
            raise ValueError
        if workers and int(tiles.max(initial=0)) >= len(workers):
            raise ValueError
    except ValueError:
        raise InputError(
            f"{source}: 'owners' does not tell tiles", "give what --json --details has printed"
        ) from None
    if sum(counts) != len(mesh.vertices) or int(tiles.max(initial=0)) >= MOST_TILES:
        return mesh, ()
    return replace(mesh, attributes={**mesh.attributes, TILE: np.repeat(tiles, counts)}), workers


def take_labels(mesh: Mesh, workers: Sequence[str]) -> tuple[Mesh, list[Field]]:
    """Turn the attribute `TILE` of a mesh into what it can be coloured by: tiles and workers.

    Without it there is nothing; without workers of each tile, only these.
    """
    if TILE not in mesh.attributes:
        return mesh, []
    tiles = mesh.attributes[TILE]
    rest = {name: column for name, column in mesh.attributes.items() if name != TILE}
    labels = [label_field("tile", "Tile", tiles, "tile")]
    if workers:
        names = sorted(set(workers), key=lambda name: (len(name), name))
        places = {name: number for number, name in enumerate(names)}
        numbers = np.array([places[name] for name in workers])
        labels.append(Field("worker", "Worker", numbers[tiles], labels=names))
    return replace(mesh, attributes=rest), labels
