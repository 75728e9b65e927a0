"""What is known of the sides of normals: whether they contradict each other, how they came about.

Every job asks; what estimates normals (`normals`) is only imported where it is needed.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

from hpcapp.applications.surface.cloud.cloud_pass import CloudPass, PassT
from hpcapp.applications.surface.cloud.measure import draw_boxes
from hpcapp.applications.surface.normals import patches
from hpcapp.applications.surface.normals.consistency import share_opposed
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.types.lattice import lay_lattice
from hpcapp.progress import StageClock
from hpccomponent.option_names import name_option

__all__ = ["Oriented", "is_contradicting", "orient_cloud"]

log = logging.getLogger("hpcapp")

_SAMPLE = 20_000  # points that show whether normals contradict each other
_CONTRADICTING = 0.12  # share of opposite pairs: 6 in 100 turned round
_DOUBTFUL = 0.9  # share of points whose side is sure, below which somebody should look


@dataclass(frozen=True, slots=True)
class Oriented:
    """How the normals of a cloud came about.

    Parameters
    ----------
    source : str
        ``file`` or ``estimated``.
    sure : float
        Share of the points whose side is sure, 0 to 1.
    turned : int
        How many normals of the file were turned round, patch by patch.
    contradict : bool
        Whether they contradict each other, and were taken as they are.
    how : str
        What tells their side, where it was looked for: ``from above``.
    doubted : tuple of float, or None
        The middle of the largest piece whose side is unsure, in the file's coordinates.
    """

    source: str
    sure: float
    turned: int = 0
    contradict: bool = False
    how: str = ""
    doubted: tuple[float, ...] | None = None

    @property
    def warnings(self) -> list[str]:
        """What should make the user doubt them."""
        found = []
        if self.contradict:
            found.append(
                "normals of neighbouring points contradict each other, the mesh means little: "
                "orient them consistently (e.g. in CloudCompare or MeshLab), or leave "
                f"{name_option('normals', 'file')} out"
            )
        if self.turned:
            found.append(
                f"the normals contradict each other: {self.turned} were turned round, so that all "
                f"are on one side; {name_option('normals', 'file')} takes them as they are"
            )
        if self.sure < _DOUBTFUL and self.doubted is not None:
            place = ", ".join(f"{value:.6g}" for value in self.doubted)
            # Above and below are along z: of no use where that is not up.
            advice = "X,Y,Z" if self.how.startswith("along") else "above, inside, or X,Y,Z"
            found.append(
                f"the side of {100.0 * (1.0 - self.sure):.1f} % of the normals is unsure, most of "
                f"it around ({place}): say where it was scanned from "
                f"({name_option('viewpoint')}: {advice})"
            )
        return found

    def report(self, shown: str) -> None:
        """Log how they came about.

        Parameters
        ----------
        shown : str
            The input, for the messages.
        """
        if self.source != "file":
            sure = 100.0 * self.sure
            log.info(
                "%s: normals: estimated; seen %s; %.1f %% of the points surely oriented",
                shown, self.how, sure,
            )  # fmt: skip
        for warning in self.warnings:
            log.warning("warning: %s: %s", shown, warning)

    def to_json(self) -> dict[str, Any]:
        """Return the same for the job's report."""
        facts = {"source": self.source, "sure": round(self.sure, 4), "turned": self.turned}
        return facts | ({"seen": self.how} if self.how else {})


def orient_cloud(
    cloud_pass: PassT,
    spacing: float,
    wanted: str,
    sensor: Sensor,
    clock: StageClock,
    *,
    has_normals: bool,
    is_oriented: bool = True,
    attribute: str | None = None,
) -> tuple[PassT, Oriented]:
    """Give points normals where they have none, or such that contradict each other.

    Parameters
    ----------
    cloud_pass : CloudPass
    spacing : float
        Of its points, in length units of the input.
    wanted : str
        ``file``: they are taken as they are, where there are some.
    sensor : Sensor
        Where the points were measured from.
    clock : StageClock
    has_normals, is_oriented : bool
        Whether the points have normals, and whether the file says that these have a side.
    attribute : str, optional
        By which name points in memory keep how sure their side is, 0 to 1.

    Returns
    -------
    cloud_pass : CloudPass
        Through points with unit normals.
    oriented : Oriented
    """
    if has_normals:
        contradict = is_contradicting(cloud_pass, spacing)
        if wanted == "file":
            return cloud_pass, Oriented("file", 1.0, contradict=contradict)
        if is_oriented and not contradict:
            return cloud_pass, Oriented("file", 1.0)
    from hpcapp.applications.surface.normals.drive import turn_normals  # scipy takes its time

    with clock.stage("normals"):
        turned_pass, turned = turn_normals(
            cloud_pass,
            spacing,
            sensor,
            keeps=has_normals,
            attribute=attribute,
        )
    place = None if turned.doubted is None else tuple(map(float, turned.doubted))
    if has_normals:
        return turned_pass, Oriented("file", turned.sure, turned.turned, False, turned.how, place)
    return turned_pass, Oriented("estimated", turned.sure, 0, False, turned.how, place)


def is_contradicting(cloud_pass: CloudPass, spacing: float) -> bool:
    """Tell whether normals contradict each other: more than one in twenty, or so, is wrong."""
    edge, points = patches.CELL * spacing, len(cloud_pass.cloud)
    sample = draw_boxes(cloud_pass, edge, points // _SAMPLE + 1)
    corner = lay_lattice(cloud_pass.cloud.low, edge)
    return share_opposed(*sample, corner, edge, spacing) > _CONTRADICTING
