"""Where the columns of points are that a mesh is to carry: beside the points, or in their file.

Points that lie in a folder have no columns there: these are put beside them when the surface is
done, in one more pass over the input, here.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from hpcapp.applications.surface.attributes.carrying import Evaluate
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.geometry.points import PointCloud
from hpcapp.io import PointSource, open_points
from hpccomponent.files.private_files import make_private_folder


class Columns(Protocol):
    """The colours and attributes of points that a mesh is to carry."""

    @property
    def layout(self) -> PointCloud:
        """Without points: which colours and attributes there are."""

    @property
    def why_no_confidence(self) -> str:
        """Why it is not known how sure the sides of the normals are, where it is not."""

    def of_cloud(self, cloud: ArrangedCloud) -> Columns:
        """Return those that the points have in the end: normals may have brought another one."""

    def open(self, cloud: ArrangedCloud, spacing: float, threads: int, at_once: int) -> Evaluate:
        """Return what tells what places take from the points near them.

        Parameters
        ----------
        cloud : ArrangedCloud
            The points.
        spacing : float
            Of the points, in length units of the input; decides about time, not about values.
        threads : int
        at_once : int
            So many points may be in memory at once, about, if they are not there.
        """


@dataclass(frozen=True, slots=True, eq=False)
class MemoryColumns:
    """The columns of points in memory; see `Columns`.

    Parameters
    ----------
    layout : PointCloud
    labels : frozenset of str
        Attributes of which no mean is to be taken.
    """

    layout: PointCloud
    labels: frozenset[str]

    @property
    def why_no_confidence(self) -> str:
        """See `Columns`."""
        return "the normals are those of the input as they are"

    def of_cloud(self, cloud: ArrangedCloud) -> Columns:
        """See `Columns`."""
        return MemoryColumns(cloud.sample(len(cloud)).view(slice(0)), self.labels)

    def open(self, cloud: ArrangedCloud, spacing: float, threads: int, at_once: int) -> Evaluate:
        """See `Columns`."""
        del spacing, at_once  # the points are here
        from hpcapp.applications.surface.attributes.carry import (
            AttributeField,  # scipy takes its time
        )

        return AttributeField(cloud.sample(len(cloud)), self.labels, threads).evaluate


@dataclass(frozen=True, slots=True, eq=False)
class FileColumns:
    """The columns of points in a folder, which are read from their file again; see `Columns`."""

    settings: JobSettings
    layout: PointCloud

    @classmethod
    def of(cls, settings: JobSettings, source: PointSource) -> FileColumns:
        """Return those of a file that are to be carried to the mesh."""
        first = next(source.chunks(1))
        return cls(settings, settings.attributes.select(first, settings.shown).view(slice(0)))

    @property
    def why_no_confidence(self) -> str:
        """See `Columns`."""
        return "it is known only where the points are in memory"

    def of_cloud(self, cloud: ArrangedCloud) -> Columns:
        """See `Columns`."""
        del cloud
        return self

    def open(self, cloud: ArrangedCloud, spacing: float, threads: int, at_once: int) -> Evaluate:
        """See `Columns`."""
        from hpcapp.applications.surface.attributes.blocks import ColumnBlocks
        from hpcapp.applications.surface.attributes.labels import LabelSearch
        from hpcapp.applications.surface.attributes.search import evaluate_blocks

        folder = Path(str(cloud.place)).parent / f"columns-{secrets.token_hex(4)}"
        make_private_folder(folder)
        columns, search = ColumnBlocks(folder, cloud, self.layout), LabelSearch()
        for part in open_points(self.settings.points).isotropic().chunks(at_once):
            chosen = self.settings.attributes.select(part, self.settings.shown)
            search.add(chosen.attributes)
            local = chosen.positions - cloud.origin if cloud.origin.any() else chosen.positions
            columns.add(PointCloud(local, None, chosen.colours, chosen.attributes))
        take, labels = columns.take_blocks, search.labels
        return partial(
            evaluate_blocks, cloud, take, labels, spacing, threads=threads, points=at_once
        )
