"""A comparison for people: its rows, and a page with the mesh coloured by its distance."""

from __future__ import annotations

from dataclasses import asdict
from html import escape
from math import isnan
from pathlib import Path

from hpcapp.applications.compare.metrics import Measures
from hpcapp.applications.compare.truth import Truth
from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.pages.page import Section, build_page
from hpcapp.pages.scene import MOST_POINTS, Field, Scene, fields_of
from hpcapp.pages.thin import thin_mesh

__all__ = ["list_measures", "make_comparison", "say_openness"]

_MOST_FACES = 500_000  # the distance of each vertex is found exactly: some 10 µs each
_LENGTHS = (
    ("accuracy", "mesh to truth, mean"),
    ("completeness", "truth to mesh, mean"),
    ("l1", "mean of both (L1)"),
    ("rms", "root mean square"),
    ("p95", "95 % are below"),
    ("hausdorff", "largest (Hausdorff)"),
)


def list_measures(measures: Measures) -> list[tuple[str, str, str]]:
    """Return the rows of a table: name, per cent of the diagonal (or the number), length."""
    unit = measures.diagonal / 100.0
    rows = [
        (label, _say(getattr(measures, name), ".5f"), _say(getattr(measures, name), ".6g", unit))
        for name, label in _LENGTHS
    ]
    rows += [
        (f"F-score at {threshold} %", f"{score:.4f}", "")
        for threshold, score in measures.f_scores.items()
    ]
    rows.append(("angle of normals, degrees", _say(measures.normal_deg, ".3f"), ""))
    rows.append(("diagonal", "100", f"{measures.diagonal:.6g}"))
    for name, value in asdict(measures.topology).items():
        if isinstance(value, tuple):
            value = ", ".join(map(str, value))
        shown = ("yes" if value else "no") if isinstance(value, bool) else str(value)
        rows.append((name.replace("_", " "), shown, ""))
    return rows


def say_openness(measures: Measures) -> str | None:
    """Say why distances from the mesh are missing; None where they are there."""
    if not isnan(measures.accuracy):
        return None
    return (
        "the truth is open: the mesh may be right where it has nothing, so that only distances "
        "from the truth to the mesh count"
    )


def _say(value: float, digits: str, unit: float = 1.0) -> str:
    return "-" if isnan(value) else format(value * unit, digits)


def make_comparison(
    path: Path, truth_name: str, mesh: Mesh, truth: Truth, measures: Measures
) -> str:
    """Return a page (HTML) with the mesh, coloured by its distance from the truth.

    Parameters
    ----------
    truth_name : str
        As the user typed it.
    truth : Truth
        In the mesh's frame.
    """
    thin = thin_mesh(mesh, _MOST_FACES)
    distance = Field("distance", "Distance to the truth", truth.distance(thin.vertices), low=0.0)
    scene = Scene(
        thin, [distance, *fields_of(thin)], truth.sample(MOST_POINTS, 0), colouring="distance"
    )
    lines = [
        f'<tr><th>{escape(name)}</th><td class="number">{share}</td>'
        f'<td class="number">{length}</td></tr>'
        for name, share, length in list_measures(measures)
    ]
    head = "<tr><th></th><th>% of diagonal</th><th>length</th></tr>"
    table = f"<table>\n{head}\n" + "\n".join(lines) + "\n</table>"
    notes = (
        "<p>Distances are exact: from points spread evenly over one surface to the nearest place "
        "on the other. The points beside the mesh are the truth's.</p>"
    )
    if openness := say_openness(measures):
        notes = f"<p>{escape(openness)}</p>" + notes
    summary = f"compared with {truth_name}"
    return build_page(path.name, summary, scene, [Section("Distances", table + notes)])
