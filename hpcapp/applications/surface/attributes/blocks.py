"""Colours and attributes of a file for a cloud in a folder, block by block as its points.

::

    columns.0   columns.1   columns.2 ...    records of one part of the input each: the place of a
    └ blocks in the order of their keys      point as it is in the cloud, and its columns

All points of the input are there. Which of them are the cloud's own, after outliers and others were
dropped, is found out as they are read: those at places where the cloud has points, the first ones
of the input where it has fewer.
"""

from __future__ import annotations

from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud, find_runs
from hpcapp.applications.surface.cloud.arrangement import snap_points
from hpcapp.geometry.lattice import find_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray, PointCloud
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError, OutputError
from hpccomponent.files.whole_files import write_whole


@dataclass(frozen=True, slots=True, eq=False)
class _ColumnPart:
    """The blocks of one file; those of a `FilePart`."""

    file: Path
    keys: IntArray
    starts: IntArray
    """Shape (b + 1,)."""


@dataclass(slots=True, eq=False)
class ColumnBlocks:
    """The colours and attributes of a cloud in a folder, which exists.

    `layout`, without points, tells which colours and attributes the file has.
    """

    folder: Path
    cloud: ArrangedCloud
    layout: PointCloud
    _parts: list[_ColumnPart] = field(default_factory=list)

    def add(self, points: PointCloud) -> None:
        """Write the next points of the input, in the cloud's frame and with the layout's columns.

        Raises OutputError where the disk is full, or the folder cannot be written.
        """
        cloud = self.cloud
        snapped = snap_points(cloud.arrangement, points.positions)
        is_within: BoolArray = (snapped >= cloud.low) & (snapped <= cloud.high)  # NaN is not
        inside: BoolArray = np.logical_and.reduce(is_within, axis=1)
        if not inside.all():
            snapped, points = snapped[inside], points.take(inside)
        if not len(snapped):
            return
        blocks = cloud.arrangement
        keys, starts, rows = kernels.sort_points(snapped, blocks.origin, blocks.edge)
        records = np.empty(len(snapped), self._dtype)
        records["place"] = snapped.take(rows, axis=0)
        if points.colours is not None:
            records["colour"] = points.colours.take(rows, axis=0)
        for number, name in enumerate(self.layout.attributes):
            records[f"a{number}"] = points.attributes[name].take(rows)
        path = self.folder / f"columns.{len(self._parts)}"
        try:
            write_whole(path, [records.view(np.uint8).data])
        except OSError as error:
            raise OutputError(
                f"{self.folder}: the attributes cannot be put there: {error.strerror or error}",
                f"name a temporary folder with {self._dtype.itemsize} bytes of room for each "
                f"point, or ask for {name_option('attributes', 'none')}",
            ) from error
        self._parts.append(_ColumnPart(path, keys, starts))

    def take_blocks(self, keys: IntArray) -> PointCloud:
        """Return the points in blocks of sorted, unique keys (k,), in the order of the cloud.

        They have their columns and those beside the cloud. Raises JobError where the folder is not
        whole, or the input was not the same when it was read again.
        """
        points, (records, blocks) = self.cloud.take_columns(keys), self._read(keys)
        counts = np.append(self.cloud.counts, 0)[find_keys(self.cloud.keys, keys)]
        differ = np.bincount(blocks, minlength=len(keys)) != counts
        if differ.any():
            own, kept = np.repeat(differ, counts), ~differ[blocks]
            kept[~kept] = _find_own(points.positions[own], records["place"][~kept])
            records = records[kept]
        if len(records) != counts.sum():
            raise JobError(
                "the points' attributes do not fit the points: the input has changed meanwhile",
                "run the job again, and leave its input alone",
            )
        colours = None if self.layout.colours is None else records["colour"]
        attributes = {name: records[f"a{i}"] for i, name in enumerate(self.layout.attributes)}
        return replace(points, colours=colours, attributes={**points.attributes, **attributes})

    def _read(self, keys: IntArray) -> tuple[NDArray[Any], IntArray]:
        """Return the records of some blocks, and to which of these each belongs."""
        found, blocks = [np.empty(0, self._dtype)], [np.empty(0, np.int64)]
        for part in self._parts:
            at = find_keys(part.keys, keys)
            held = np.flatnonzero(at < len(part.keys))
            if not len(held):
                continue
            records, rows = self._map(part), at[held]
            found += [
                records[part.starts[run.start] : part.starts[run.stop]] for run in find_runs(rows)
            ]
            blocks.append(np.repeat(held, np.diff(part.starts)[rows]))
        numbers = np.concatenate(blocks)
        order = np.argsort(numbers, kind="stable")
        return np.concatenate(found)[order], numbers[order]

    def _map(self, part: _ColumnPart) -> NDArray[Any]:
        try:
            records = np.memmap(part.file, self._dtype, "r")
        except (OSError, ValueError) as error:
            raise JobError(
                f"{part.file}: the attributes that were put there cannot be read: {error}",
                "run the job again; nobody may touch its temporary folder meanwhile",
            ) from error
        if len(records) != part.starts[-1]:
            raise JobError(
                f"{part.file} is not whole",
                "run the job again; nobody may touch its temporary folder meanwhile",
            )
        return records

    @property
    def _dtype(self) -> np.dtype[Any]:
        fields: list[tuple[Any, ...]] = [("place", np.float64, 3)]
        if self.layout.colours is not None:
            fields.append(("colour", self.layout.colours.dtype, 3))
        columns = self.layout.attributes.values()
        fields += [(f"a{number}", column.dtype) for number, column in enumerate(columns)]
        return np.dtype(fields)


def _find_own(own: FloatArray, places: FloatArray) -> BoolArray:
    """Tell which of some places are a cloud's own: of each place as many as the cloud has there."""
    both = np.concatenate([own, places])
    order = np.lexsort(both.T)  # stable: first the cloud's, then the others in their order
    ordered = both[order]
    begins = np.ones(len(both), np.bool_)
    begins[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    group, starts = np.cumsum(begins) - 1, np.flatnonzero(begins)
    is_own = order < len(own)
    wanted = np.bincount(group[is_own], minlength=len(starts))[group]
    number = np.arange(len(both)) - starts[group] - wanted
    found = np.zeros(len(places), np.bool_)
    found[order[~is_own & (number < wanted)] - len(own)] = True
    return found
