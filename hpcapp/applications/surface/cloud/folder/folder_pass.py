"""The pass through a cloud in a folder, region by region, by workers."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from hpcapp.applications.surface.cloud.arranged import CloudMeasures
from hpcapp.applications.surface.cloud.folder.disk import DiskCloud, write_index
from hpcapp.applications.surface.cloud.folder.parts import FilePart, write_attribute, write_part
from hpcapp.applications.surface.cloud.point_workers import PassWatch, PointWorkers
from hpcapp.applications.surface.cloud.tasks import bound_region
from hpcapp.geometry.points import FloatArray
from hpcapp.progress import Progress
from hpccomponent.dataclass import dataclass
from hpccomponent.files.private_files import make_private_folder

Result = TypeVar("Result")

_PREFIX = "points-"  # of the folders of clouds


@dataclass(frozen=True, slots=True, eq=False)
class FolderPass:
    """The pass through a cloud in a folder, by whoever sees it.

    In `place` clouds get folders: some 17 bytes for each point that changes. The `watch` is told
    how far this pass, and those that come of it, have come.
    """

    cloud: DiskCloud
    place: Path
    workers: PointWorkers
    watch: PassWatch = field(default_factory=PassWatch)

    @property
    def threads(self) -> int:
        """See `CloudPass`."""
        workforce = self.workers.workforce
        return workforce.workers if workforce.in_process else 1

    def each(self, task: Callable[..., Result], *given: Any, margin: float = 0.0) -> list[Result]:
        """See `CloudPass`."""
        results = self.workers.run(task, self.cloud, margin, given, None, self.watch)
        return [result for _, _, result in sorted(results, key=itemgetter(0))]

    def rewrite(
        self,
        task: Callable[..., Any],
        *given: Any,
        margin: float = 0.0,
        accepts: Callable[[list[Any]], bool] = lambda _: True,
        attribute: str | None = None,
    ) -> tuple[FolderPass, list[Any]]:
        """See `CloudPass`."""
        folder = make_cloud_folder(self.place)
        parts: dict[int, FilePart] = {}
        columns: dict[int, FilePart] = {}
        others: dict[int, tuple[Any, ...]] = {}
        for index, is_written, (replaced, *rest) in self.workers.run(
            task, self.cloud, margin, given, folder, self.watch
        ):
            if replaced is not None:
                # Whoever does not see the folder has sent the blocks, and they are written here.
                blocks = replaced if is_written else write_part(folder, index, [replaced])
                parts[index] = part = FilePart.whole(index, *blocks)
                if attribute is not None:
                    columns[index] = write_attribute(folder, attribute, part, index, rest.pop())
            others[index] = tuple(rest)
        results = [others[index] for index in sorted(others)]
        cloud_pass = self
        if parts and accepts(results):
            added = {} if attribute is None else {attribute: [columns[i] for i in sorted(columns)]}
            cloud_pass = self._replace(folder, [parts[i] for i in sorted(parts)], added)
        cloud_pass._remove_others()
        return cloud_pass, results

    def watched(self, progress: Progress, passes: Mapping[str, int]) -> FolderPass:
        """See `CloudPass`."""
        return replace(self, watch=PassWatch(progress, passes))

    def note(self, measured: CloudMeasures) -> FolderPass:
        """See `CloudPass`."""
        cloud = self.cloud
        box = cloud.low, cloud.high
        return self._index(cloud.folder, box, cloud.parts, cloud.attributes, measured)

    def _replace(
        self, folder: Path, parts: list[FilePart], added: Mapping[str, list[FilePart]]
    ) -> FolderPass:
        """Return the pass through a cloud some of whose blocks are in new parts."""
        cloud = self.cloud
        changed = np.sort(np.concatenate([part.keys for part in parts]))
        there = os.path.relpath(cloud.folder, folder)
        # Blocks that have not changed stay in the files that they are in.
        kept = [part.without(changed, there) for part in cloud.parts]
        written = [part for part in (*kept, *(part.filled() for part in parts)) if len(part.keys)]
        columns = {
            name: [part.without(changed[:0], there) for part in some]
            for name, some in cloud.attributes.items()
        }
        replaced = self._index(folder, (cloud.low, cloud.high), written, {**added, **columns})
        if len(replaced.cloud) == len(cloud) or cloud.arrangement.box is not None:
            return replaced
        # Points are gone, and with them what may have bounded the box.
        assert not replaced.cloud.attributes  # noqa: S101 - see `CloudPass.rewrite`
        boxes = np.stack(replaced.each(bound_region))
        box = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        return replaced._index(folder, box, written, {})

    def _index(
        self,
        folder: Path,
        box: tuple[FloatArray, FloatArray],
        parts: list[FilePart],
        attributes: Mapping[str, Sequence[FilePart]],
        measured: CloudMeasures | None = None,
    ) -> FolderPass:
        known = self.cloud.arrangement, self.cloud.origin
        indexed = write_index(folder, *known, box, parts, measured, attributes)
        return replace(self, cloud=indexed)

    def _remove_others(self) -> None:
        """Remove the clouds that this one has come of, but for the parts that it still has."""
        for folder in self.place.glob(f"{_PREFIX}*"):
            if folder != self.cloud.folder and not self.cloud.uses(folder):
                shutil.rmtree(folder, ignore_errors=True)  # one may write there still


def make_cloud_folder(place: Path) -> Path:
    """Make a folder for a cloud, of a name that no worker of an earlier run writes to."""
    folder = place / f"{_PREFIX}{secrets.token_hex(4)}"
    make_private_folder(folder)
    return folder
