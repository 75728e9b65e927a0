"""How the normals of a cloud came about, and what is unsure of their sides."""

from __future__ import annotations

import logging
from dataclasses import asdict
from typing import Any, Literal, Self

from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass

log = logging.getLogger("hpcapp")

Judgement = Literal["agree", "contradict", "follow a place"]
"""What normals of neighbouring points say of each other's side."""


_DOUBTFUL = 0.9  # share of points whose side is sure, below which somebody should look


@dataclass(frozen=True, slots=True)
class Unsure:
    """What is unsure of the sides of normals.

    `place` is the middle of the largest piece whose side is, in the file's coordinates. `seen` says
    where it is taken to be seen from and where else it may be (``from above``), `options` what
    tells so (``--viewpoint``); both are empty where nothing explains it.
    """

    place: tuple[float, ...]
    seen: tuple[str, ...] = ()
    options: tuple[str, ...] = ()

    @property
    def advice(self) -> str:
        """What a user can do."""
        if not self.options:
            words = name_option("viewpoint")
            return f"say where it was scanned from ({words}: above, outside, inside, or X,Y,Z)"
        taken, other = self.seen
        asked = " or ".join(name_option("viewpoint", option) for option in self.options)
        return f"it is taken as seen {taken}, and may be seen {other}: decide by {asked}"


@dataclass(frozen=True, slots=True)
class Oriented:
    """How the normals of a cloud came about.

    They are of the ``file`` or ``estimated``, by `source`. The side of a share of the points is
    `sure`; `flipped` normals of the file were turned round, patch by patch. The `judgement` tells
    whether those of a file agree on a side, `how` what tells it where it was looked for: ``from
    above``.
    """

    source: str
    sure: float
    flipped: int = 0
    judgement: Judgement = "agree"
    how: str = ""
    doubt: Unsure | None = None

    @classmethod
    def of(cls, told: dict[str, Any]) -> Self:
        """Return what `asdict` has told."""
        doubt = told["doubt"]
        if doubt is not None:
            doubt = Unsure(*(tuple(doubt[name]) for name in ("place", "seen", "options")))
        return cls(**{**told, "doubt": doubt})

    @property
    def is_believed(self) -> bool:
        """Whether their side is that of the file, and they agree on it."""
        return self.source == "file" and self.judgement == "agree" and not self.how

    @property
    def warnings(self) -> list[str]:
        """What should make the user doubt them."""
        found = []
        what = {
            "contradict": "the normals contradict each other",
            "follow a place": "the sides of the normals follow one direction or place, not a "
            "surface",
        }.get(self.judgement)
        given = name_option("normals", "file")
        if self.flipped:
            what = what or "the normals have no side"
            found.append(
                f"{what}: {self.flipped} were turned round, so that all are on one side; {given} "
                "takes them as they are"
            )
        elif what and not self.how:
            found.append(
                f"{what}, the mesh means little: orient them consistently (e.g. in CloudCompare "
                f"or MeshLab), or leave {given} out"
            )
        if self.sure < _DOUBTFUL and self.doubt is not None:
            place = ", ".join(f"{value:.6g}" for value in self.doubt.place)
            found.append(
                f"the side of {100.0 * (1.0 - self.sure):.1f} % of the normals is unsure, most of "
                f"it around ({place}): {self.doubt.advice}"
            )
        return found

    def report(self, shown: str) -> None:
        """Log how they came about; the messages name the input as `shown`."""
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
        facts = {"source": self.source, "sure": round(self.sure, 4), "turned": self.flipped}
        seen = {"seen": self.how} if self.how else {}
        unsure = {"unsure": asdict(self.doubt)} if self.doubt else {}
        return facts | seen | unsure
