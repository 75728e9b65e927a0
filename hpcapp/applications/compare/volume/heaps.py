"""The volumes of heaps for people and for spreadsheets."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from io import StringIO
from pathlib import Path

from hpcapp.applications.compare.volume.heap import FLAT, RIM, Heap
from hpcapp.io.staging import replacing
from hpcapp.wording import say_number

_FEW = 0.01  # of a heap: less than that has no points along the border of the polygon
_PARTS = {
    "from_noise": "noise", "from_base": "the ground below", "from_polygon": "the polygon",
    "from_hidden": "hidden", "from_cells": "the cells",
}  # fmt: skip
_BASES = {
    RIM: "what the ground round it is continued to", FLAT: "the plane through the ground round it",
}  # fmt: skip


def list_rows(heaps: Sequence[Heap], unit: str) -> list[tuple[str, ...]]:
    """Return a table, with its head: what each heap is, and what makes it most uncertain."""
    cubed, squared = (f"{unit}³", f"{unit}²") if unit else ("", "")
    rows: list[tuple[str, ...]] = [
        ("", "volume", "uncertainty", "most of it", "area", "height", "")
    ]
    for heap in heaps:
        most = max(_PARTS, key=partial(getattr, heap))
        rows.append((
            heap.name, say_number(heap.volume, cubed), f"± {say_number(heap.uncertainty, cubed)}",
            _PARTS[most], say_number(heap.area, squared), say_number(heap.height, unit),
            "" if heap.is_significant else "no heap is told",
        ))  # fmt: skip
    return rows


def list_notes(heaps: Sequence[Heap], above: str, unit: str) -> Iterator[str]:
    """Yield what was taken for the base, and what a user has to know of single heaps."""
    yield f"the base is {_BASES.get(above, f'the height {above}')}; uncertainties are of 95 %"
    for heap in heaps:
        if heap.grown:
            yield (
                f"{heap.name}: its foot goes on beyond the polygon: it is measured up to "
                f"{say_number(heap.grown, unit)} outside"
            )
        if not heap.is_still:
            yield (
                f"{heap.name}: the volume changes as the polygon is widened, which is in the "
                "uncertainty: draw it along the toe, and say how well by --registration"
            )
        if heap.hidden > _FEW * heap.area:
            area = say_number(heap.hidden, unit and f"{unit}²")
            yield f"{heap.name}: {area} of it show no points, and are filled from around"


def list_values(heaps: Sequence[Heap], unit: str) -> list[dict[str, object]]:
    """Return the heaps as plain values."""
    return [
        asdict(heap) | {"is_significant": heap.is_significant, "unit": unit or None}
        for heap in heaps
    ]


def write_csv(path: Path, heaps: Sequence[Heap], unit: str) -> None:
    """Write a table of heaps, a line each; raise OutputError where it cannot be written."""
    text, values = StringIO(), list_values(heaps, unit)
    table = csv.DictWriter(text, list(values[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(values)
    with replacing(path) as file:
        file.write(text.getvalue().encode())
