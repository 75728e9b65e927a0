"""The report of a job, as JSON values; its keys are in ``docs/reference/reconstruct.md``."""

from __future__ import annotations

from typing import Any

from hpcapp.applications.surface.attributes.carrying import Carrying
from hpcapp.applications.surface.job.outcome import Outcome
from hpcapp.applications.surface.job.scan import Loaded
from hpcapp.applications.surface.job.settings import Settings
from hpcapp.applications.surface.steps.summary import summarize
from hpcapp.applications.surface.stitching.topology import Topology
from hpcapp.kernels.build import kernel_id


def describe_outcome(
    settings: Settings, loaded: Loaded, outcome: Outcome, topology: Topology, carrying: Carrying
) -> dict[str, Any]:
    """Return the report of a job, but for its input and its output."""
    report = _describe(settings, outcome, topology)
    report["attributes"] = carrying.names
    report["warnings"] = [
        *loaded.findings.warnings,
        *loaded.oriented.warnings,
        *outcome.warnings,
    ]
    report["dropped"] = {
        **loaded.findings.dropped,
        "non_finite_points": loaded.dropped.non_finite_points,
        "bad_normals": loaded.dropped.bad_normals,
        "duplicates": loaded.cleaned.repeated,
        "outliers": loaded.cleaned.outliers,
        "strays": loaded.cleaned.strays,
        "lone_lines": loaded.cleaned.lone_lines,
    }
    report["smoothed_depths"] = loaded.cleaned.smoothed
    report["turned_normals"] = loaded.cleaned.flipped
    report["scan_lines"] = loaded.cleaned.tell_lines()
    report["up"] = carrying.placement.up
    report["normals"] = loaded.oriented.to_json()
    report["reading"] = loaded.reading.to_json()
    return report


def _describe(settings: Settings, outcome: Outcome, topology: Topology) -> dict[str, Any]:
    result, backend = outcome.result, outcome.backend
    traffic = backend.traffic()
    return {
        "summary": summarize(topology, result.facts),
        "method": settings.method.name,
        "kernels": kernel_id(),
        "points": result.points,
        **result.facts,
        "grid": outcome.grid,
        "vertices": topology.vertices,
        "faces": topology.faces,
        "watertight": topology.watertight,
        "edge_manifold": topology.edge_manifold,
        "vertex_manifold": topology.vertex_manifold,
        "boundaries": topology.boundaries,
        "components": topology.components,
        "genus": topology.genus,
        "backend": backend.name,
        "workers": backend.workforce.workers,
        "choice": outcome.choice.to_json(),
        "policy": settings.policy,
        "bytes_sent": traffic.bytes_sent,
        "bytes_received": traffic.bytes_received,
    }
