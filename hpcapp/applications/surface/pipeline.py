"""The road of a scan to its mesh: the master process of the paper's Figure 1, stage by stage.

::

    read ─> clean ─> orient ─> mend ─> measure                         a cloud (load, prepare)
       ─> resolve ─> partition ─> fit ─> extract ─> close              a surface (reconstruct_cloud)
       ─> crop ─> keep pieces ─> simplify                              what was asked of it
       ─> carry ─> write ─> check                                      a mesh (deliver)

A stage is a call of its name, in the room of its name. Folders, files and machines are opened
around the road: by `cli.run` for files, by `hpcapp.api` for arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from hpcapp.applications.surface.attributes.carrying import Carrying
from hpcapp.applications.surface.cleaning.drive import clean, mend_normals
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.frame import Frame
from hpcapp.applications.surface.cloud.measure import find_measures
from hpcapp.applications.surface.job.outcome import Outcome, Reconstruction
from hpcapp.applications.surface.job.resume import find_loaded, note_loaded
from hpcapp.applications.surface.job.scan import Loaded, PointFolder, Scan
from hpcapp.applications.surface.job.settings import JobSettings, Settings
from hpcapp.applications.surface.job.site import Site, open_method, preprocess
from hpcapp.applications.surface.job.source import describe_input, open_whole, take_asked
from hpcapp.applications.surface.methods.method import Method
from hpcapp.applications.surface.normals.sides import orient_cloud
from hpcapp.applications.surface.resolution.asked import find_grid
from hpcapp.applications.surface.steps.carry import carry_columns
from hpcapp.applications.surface.steps.diagnostics import check_points, warn_of
from hpcapp.applications.surface.steps.pieces import keep_pieces
from hpcapp.applications.surface.steps.read import read_file
from hpcapp.applications.surface.steps.simplify import fit_surface, simplify
from hpcapp.applications.surface.stitching.topology import Topology
from hpcapp.progress import StageClock
from hpcapp.workforce import Workforce
from hpccomponent.runtime.background import Deferred

# How often stages go through the points, about; more often where strays are dropped.
_PASSES = {"clean": 8, "normals": 5, "mend normals": 1}


def load(
    settings: JobSettings,
    clock: StageClock,
    folder: PointFolder | None = None,
    frame: Frame | None = None,
) -> Loaded:
    """Read a job's points, and make of them what its method takes.

    They are put into the folder, or into memory: they are the same, bit for bit. With `resume`,
    what is in the folder is taken, if it is whole. By default they lie in a frame of their own.
    """
    frame = Frame() if frame is None else frame
    whole = open_whole(settings)
    if settings.printing is not None:
        settings.printing.find_unit(whole.unit)  # refused before the work
    source, described = take_asked(settings, whole), describe_input(settings, whole)
    if folder is not None and settings.resume and (left := find_loaded(settings, source, folder)):
        return replace(left, described=described)
    loaded = prepare(settings, read_file(settings, source, folder, frame, clock), frame, clock)
    if folder is not None:
        note_loaded(loaded, folder)
    return replace(loaded, described=described)


def prepare(settings: Settings, scan: Scan, frame: Frame, clock: StageClock) -> Loaded:
    """Clean points that were read, give them normals, and measure their scale.

    Raises InputError where they are too few, or have no normals and lie on no surface.
    """
    method, has_normals = settings.method, scan.has_normals
    with clock.stage("clean") if method.cleans else nullcontext():
        cloud_pass, cleaned, scale = clean(
            scan.cloud_pass.watched(clock.progress, _PASSES),
            frame,
            drops=method.cleans,
            in_cells=not method.needs_whole_cloud,
            has_normals=has_normals,
        )
    cloud_pass, oriented, reading = orient_cloud(
        cloud_pass, scale, settings.normals, scan.sensor, clock,
        has_normals=has_normals, is_oriented=scan.is_oriented, is_upright=scan.is_upright,
        attribute=settings.attributes.name_confidence(scan.columns.layout),
    )  # fmt: skip
    if method.cleans:
        with clock.stage("mend normals"):
            cloud_pass, flipped = mend_normals(cloud_pass, scale.spacing)
        cleaned = replace(cleaned, flipped=flipped)
    measures = frame.measure(partial(find_measures, cloud_pass, scale, reading))
    cloud = cloud_pass.note(measures).cloud
    return scan.loaded(cloud, cleaned, oriented)


@contextmanager
def reconstruct_cloud(
    settings: Settings,
    loaded: Loaded,
    open_site: Callable[[int], AbstractContextManager[Site]],
    clock: StageClock,
) -> Iterator[Outcome]:
    """Turn a cloud into a surface.

    `open_site` opens where it runs, for a grid of so many cells along the longest side.
    """
    settings = settings.for_reading(loaded.reading)
    grid = find_grid(settings, loaded.cloud)
    with open_site(grid) as site:
        checks = Deferred(partial(check_points, grid, loaded.cloud))
        method = open_method(settings, site, grid, loaded.cloud, clock)
        cloud = preprocess(settings, loaded.cloud, clock)
        result = make_surface(cloud, method, site.backend.workforce, clock, checks)
        if settings.crop.has_region:
            from hpcapp.applications.surface.steps.crop import crop  # stands on scipy

            result = crop(settings.crop, loaded, result, clock)
        result = keep_pieces(settings.piece_choice, result, clock)
        warnings = warn_of(settings, loaded, checks(), result)
        fine = None if settings.texture is None else result.surface
        result, more = simplify(settings.target, result, clock)
        yield Outcome(result, grid, site.backend, site.choice, warnings + more, fine)


def make_surface(
    cloud: ArrangedCloud,
    method: Method[Any, Any],
    workforce: Workforce,
    clock: StageClock,
    background: Callable[[], object] | None = None,
) -> Reconstruction:
    """Take the paper's steps: cut a cloud, fit quadrics, blend them and extract the surface.

    The cloud has finite positions and unit normals. `background` is left for `Workforce.defer` once
    the cloud is cut: short passes before would wait for it.
    """
    advance = clock.progress.advance
    with clock.stage("partition"):
        partition = method.partition(cloud, workforce)
    if background is not None:
        workforce.defer(background)
    with clock.stage("fit"):
        quadrics = method.fit(partition, workforce, advance)
    with clock.stage("extract"):
        surface = method.extract(partition, quadrics, workforce, advance)
    with clock.stage("close"):
        surface = method.close(partition, surface, workforce, advance)
    return Reconstruction(surface, len(cloud), method.facts(partition))


def deliver(
    settings: JobSettings, loaded: Loaded, outcome: Outcome, target: Path, clock: StageClock
) -> tuple[Outcome, Carrying, Topology]:
    """Write a surface, with what its vertices carry, to a file of the size that is asked for."""
    carrying = carry_columns(settings, loaded, outcome, clock)
    if settings.size is not None:
        with clock.stage("fit size"):
            named = settings.attributes.named
            outcome, carrying = fit_surface(outcome, settings.size, target.suffix, carrying, named)
    if settings.texture is not None:
        from hpcapp.applications.surface.steps.texture import write_textured  # stands on scipy

        outcome = write_textured(settings, outcome, carrying, target, clock)
    elif settings.printing is not None:
        from hpcapp.applications.surface.steps.print import write_print  # stands on scipy

        return write_print(settings, outcome, carrying, target, clock)
    else:
        with clock.stage("write"):
            outcome.result.surface.write(target, outcome.backend.workforce, carrying)
    with clock.stage("check"):  # most of it is done while workers write
        return outcome, carrying, outcome.result.surface.check()
