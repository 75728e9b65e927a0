"""What is known of a scan: as it was read, and as the methods take it."""

from __future__ import annotations

import logging
from dataclasses import field
from pathlib import Path
from typing import Any

from hpcapp.applications.surface.cleaning.drive import Cleaned
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.cloud_pass import CloudPass
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.job.columns import CarriedColumns
from hpcapp.applications.surface.normals.oriented import Oriented
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.types.reading import Reading
from hpcapp.geometry.validity import Dropped
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.points.point_source import Findings
from hpccomponent.dataclass import dataclass

log = logging.getLogger("hpcapp")


@dataclass(frozen=True, slots=True, eq=False)
class PointFolder:
    """A folder that a job's points are put into, and who goes through them there.

    It is made where there is none; some 17 bytes a point are written, and those of blocks that
    change again.
    """

    path: Path
    workers: PointWorkers


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Points as they were read, each place once, and what is known of them.

    Left out so far were points that cannot be used (`dropped`), and such as lie far away or at the
    place of another (`cleaned`). Where there are normals, `is_oriented` says that the input gives
    them a side; `is_upright`, that z is known to point up, as on a map. Heights are in the unit of
    x and y here.
    """

    cloud_pass: CloudPass
    dropped: Dropped
    cleaned: Cleaned
    columns: CarriedColumns
    has_normals: bool
    is_oriented: bool = True
    sensor: Sensor = field(default_factory=Sensor)
    is_upright: bool = False
    crs: Crs = UNKNOWN
    findings: Findings = field(default_factory=Findings)

    def loaded(self, cloud: ArrangedCloud, cleaned: Cleaned, oriented: Oriented) -> Loaded:
        """Return what has become of it, with what was cleaned since it was read."""
        cleaned = self.cleaned.plus(cleaned)
        return Loaded(cloud, self.dropped, cleaned, self.columns, oriented, self.findings, self.crs)


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A cloud, what was left out of it, and how its normals came about.

    The `findings` are what is odd about the file, `described` what the input is (see
    `describe_input`), empty where it is no file.
    """

    cloud: ArrangedCloud
    dropped: Dropped
    cleaned: Cleaned
    columns: CarriedColumns
    oriented: Oriented
    findings: Findings
    crs: Crs
    described: dict[str, Any] = field(default_factory=dict)

    @property
    def reading(self) -> Reading:
        """What the scan is of."""
        return self.cloud.measured.reading

    def report(self, shown: str) -> None:
        """Log what was left out of the input, which messages call `shown`."""
        for line in self.findings.lines():
            log.warning("warning: %s: %s", shown, line)
        dropped, cleaned = self.dropped, self.cleaned
        if cleaned.spared:
            log.info(
                "%s: scan lines some %.3g apart, with points every %.3g: %d of these spared",
                shown, cleaned.line_gap, cleaned.line_step, cleaned.spared,
            )  # fmt: skip
        if cleaned.smoothed:
            log.info("%s: smoothed the steps of %d depths", shown, cleaned.smoothed)
        for count, what in (
            (dropped.non_finite_points, "dropped %d points that are NaN or Inf"),
            (dropped.bad_normals, "dropped %d points whose normal is zero, NaN or Inf"),
            (cleaned.repeated, "dropped %d points at the place of another"),
            (cleaned.outliers, "dropped %d outliers"),
            (cleaned.strays, "dropped %d stray points near the surface"),
            (cleaned.lone_lines, "dropped %d points along lone lines: wires have no surface"),
            (cleaned.flipped, "flipped %d inconsistent normals"),
        ):
            if count:
                log.warning(f"%s: {what}", shown, count)
        self.oriented.report(shown)
