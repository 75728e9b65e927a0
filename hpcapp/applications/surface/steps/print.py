"""A surface made a print, as the last step before it is written."""

from __future__ import annotations

import logging
from dataclasses import asdict, replace
from pathlib import Path

from hpcapp.applications.surface.attributes.carrying import Carrying
from hpcapp.applications.surface.job.outcome import Outcome
from hpcapp.applications.surface.job.settings import Settings
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.applications.surface.stitching.topology import Topology
from hpcapp.io import write_mesh
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.io.placement import Placement
from hpcapp.printing.prepare import PRINTED, make_print
from hpcapp.progress import StageClock

log = logging.getLogger("hpcapp")


def write_print(
    settings: Settings, outcome: Outcome, carrying: Carrying, target: Path, clock: StageClock
) -> tuple[Outcome, Carrying, Topology]:
    """Write a print of a surface, which takes its place; the facts tell then what it is."""
    assert settings.printing is not None  # noqa: S101 - or nobody would call
    with clock.stage("print"):
        mesh = outcome.result.surface.mesh(carrying)
        up, pieces = carrying.placement.up, settings.pieces or 1
        made, facts = make_print(mesh, carrying.crs, settings.printing, up, pieces)
    log.info("%s", facts.describe())
    with clock.stage("write"):
        write_mesh(target, replace(as_stream(made), crs=PRINTED), Placement(up="z"))
    surface = Surface.of_mesh(made)
    result = replace(
        outcome.result,
        surface=surface,
        facts={**outcome.result.facts, "print": asdict(facts)},
    )
    printed = replace(outcome, result=result, warnings=[*outcome.warnings, *facts.warnings])
    bare = replace(carrying, evaluate=None, crs=PRINTED, placement=Placement(up="z"))
    return printed, bare, surface.check()
