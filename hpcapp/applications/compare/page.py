"""A comparison for people: its rows, and a page with the mesh coloured by its distance."""

from __future__ import annotations

from dataclasses import asdict
from math import isnan
from pathlib import Path

from hpcapp.applications.compare.metrics import Measures
from hpcapp.applications.compare.truth import Truth
from hpcapp.geometry.mesh import Mesh
from hpcapp.io.placement import choose_up
from hpcapp.pages.page import build_page, tabulate
from hpcapp.pages.scene import MOST_POINTS, Field, Scene, fields_of
from hpcapp.pages.thin import thin_mesh
from hpcapp.wording import say_name, say_number, say_share

_MOST_FACES = 500_000  # the distance of each vertex is found exactly: some 10 µs each
_LENGTHS = (
    ("accuracy", "mesh to truth, mean"),
    ("completeness", "truth to mesh, mean"),
    ("l1", "mean of both (L1)"),
    ("rms", "root mean square"),
    ("p95", "95 % are below"),
    ("hausdorff", "largest (Hausdorff)"),
)
_NOTE = (
    "Distances are exact: from points spread evenly over one surface to the nearest place on the "
    "other. The points beside the mesh are the truth's."
)


def list_lengths(measures: Measures, unit: str) -> list[tuple[str, str, str]]:
    """Return the rows of a table of lengths: name, length, and per cent of the diagonal."""
    percent = measures.diagonal / 100.0
    rows = [(label, float(getattr(measures, name))) for name, label in _LENGTHS]
    rows.append(("diagonal of the truth", 100.0))
    return [
        (label, "-", "-")
        if isnan(share)
        else (label, say_number(share * percent, unit), f"{share:.4f}")
        for label, share in rows
    ]


def list_agreement(measures: Measures) -> dict[str, str]:
    """Return what else was measured, by its name."""
    rows = {f"F-score at {t} %": say_share(score) for t, score in measures.f_scores.items()}
    angle = measures.normal_deg
    return rows | {"angle of normals, mean": "-" if isnan(angle) else f"{say_number(angle)}°"}


def list_topology(measures: Measures) -> dict[str, str]:
    """Return what the mesh is, by its name."""
    return {say_name(name): _say(value) for name, value in asdict(measures.topology).items()}


def say_openness(measures: Measures) -> str | None:
    """Say why distances from the mesh are missing; None where they are there."""
    if not isnan(measures.accuracy):
        return None
    return (
        "the truth is open: the mesh may be right where it has nothing, so that only distances "
        "from the truth to the mesh count"
    )


def _say(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_say, value)) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else "-" if value is None else str(value)


def make_comparison(
    path: Path, truth_name: str, mesh: Mesh, truth: Truth, measures: Measures
) -> str:
    """Return a page (HTML) with the mesh, coloured by its distance from the truth.

    Both are in one frame; the truth's name is as the user typed it.
    """
    thin = thin_mesh(mesh, _MOST_FACES)
    distances, sides = truth.distance(thin.vertices), truth.find_sides(thin.vertices)
    distance = Field("distance", "Distance to the truth", distances, truth.unit, low=0.0)
    if sides is not None:
        distance = Field(
            "distance", "Distance to the truth", sides * distances, truth.unit, is_signed=True
        )
    scene = Scene(
        thin, [distance, *fields_of(thin)], truth.sample(MOST_POINTS, 0), colouring="distance",
        up=choose_up(thin), unit=truth.unit,
    )  # fmt: skip
    notes = [*filter(None, [say_openness(measures)]), _NOTE]
    head = ("", "length", "% of diagonal")
    sections = [
        tabulate("Distances", list_lengths(measures, truth.unit), head, notes),
        tabulate("Agreement", list_agreement(measures)),
        tabulate("Mesh", list_topology(measures)),
    ]
    return build_page(path.name, f"compared with {truth_name}", scene, sections)
