"""Where the columns of points are that a mesh is to carry: beside the points, or in their file.

Beside points that lie in a folder is only what was found out about them. The columns of their file
are put there when the surface is done, in one more pass over the input, here.
"""

from __future__ import annotations

import secrets
from dataclasses import replace
from functools import partial
from pathlib import Path

from hpcapp.applications.surface.attributes.carrying import Evaluate
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.job.source import open_source
from hpcapp.geometry.points import PointCloud
from hpcapp.io import PointSource
from hpccomponent.dataclass import dataclass
from hpccomponent.files.private_files import make_private_folder


@dataclass(frozen=True, slots=True, eq=False)
class CarriedColumns:
    """The colours and attributes of points that a mesh is to carry.

    The `layout` is that of the input, without points. Of the attributes in `labels` no mean is to
    be taken; of a file they are found as it is read again. `file` is the job whose input has the
    columns; None where they lie beside the points.
    """

    layout: PointCloud
    labels: frozenset[str] = frozenset()
    file: JobSettings | None = None

    @classmethod
    def of_file(cls, settings: JobSettings, source: PointSource) -> CarriedColumns:
        """Return those of a file that are to be carried to the mesh."""
        first = settings.attributes.select(next(source.chunks(1)), settings.shown)
        return cls(first.view(slice(0)), file=settings)

    def with_found(self, cloud: ArrangedCloud) -> PointCloud:
        """Return the layout of all, also of what was found out about the points."""
        beside = cloud.take_columns(cloud.keys[:0]).attributes
        return replace(self.layout, attributes={**beside, **self.layout.attributes})

    def open(self, cloud: ArrangedCloud, spacing: float, threads: int, at_once: int) -> Evaluate:
        """Return what tells what places take from the points near them.

        `spacing` decides about time, not about values. About `at_once` points may be in memory at
        once, if they are not there already.
        """
        if self.file is None:
            from hpcapp.applications.surface.attributes.carry import (
                AttributeField,  # scipy takes its time
            )

            return AttributeField(cloud.take_columns(cloud.keys), self.labels, threads).evaluate
        from hpcapp.applications.surface.attributes.blocks import ColumnBlocks
        from hpcapp.applications.surface.attributes.labels import LabelSearch
        from hpcapp.applications.surface.attributes.search import evaluate_blocks

        folder = Path(str(cloud.place)).parent / f"columns-{secrets.token_hex(4)}"
        make_private_folder(folder)
        columns, search = ColumnBlocks(folder, cloud, self.layout), LabelSearch()
        for part in open_source(self.file).chunks(at_once):
            chosen = self.file.attributes.select(part, self.file.shown)
            search.add(chosen.attributes)
            local = chosen.positions - cloud.origin if cloud.origin.any() else chosen.positions
            columns.add(PointCloud(local, None, chosen.colours, chosen.attributes))
        take, labels = columns.take_blocks, search.labels
        return partial(
            evaluate_blocks, cloud, take, labels, spacing, threads=threads, points=at_once
        )
