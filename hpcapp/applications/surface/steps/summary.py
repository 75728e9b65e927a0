"""A job's mesh in one line: for the terminal, the report and its page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hpcapp.applications.surface.stitching.topology import Topology
from hpcapp.wording import say_count, say_share


def summarize(topology: Topology, facts: Mapping[str, Any]) -> str:
    """Say in one line what a mesh is, and how much of it, by the facts, the points support."""
    is_open = topology.edge_manifold and topology.vertex_manifold and topology.boundaries > 0
    borders = say_count(topology.boundaries, "boundary", "boundaries")
    kind = f"open, {borders}" if is_open else "not watertight"
    parts = [
        say_count(topology.vertices, "vertex", "vertices"),
        say_count(topology.faces, "face"),
        "watertight" if topology.watertight else kind,
        say_count(topology.components, "piece"),
    ]
    support = say_support(facts)
    return ", ".join(parts) + (f"; {support}" if support else "")


def say_support(facts: Mapping[str, Any]) -> str:
    """Say how much of a closed mesh the points support; nothing where nobody has looked.

    Examples
    --------
    >>> found = {"share": 0.98349, "farthest": 0.26, "reach": 0.1}
    >>> say_support({"support": found, "spacing": 0.02})
    '98.3 % supported by points; the rest is up to 13 spacings away'
    """
    support = facts.get("support")
    if support is None:
        return ""
    said = f"{say_share(support['share'])} supported by points"
    spacings = round(support["farthest"] / facts["spacing"])
    if not spacings:
        return said
    return f"{said}; the rest is up to {say_count(spacings, 'spacing')} away"
