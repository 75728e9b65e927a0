"""The surface of a cloud that is one tile, made right here: its finest level slab by slab.

::

    points ─> coarser levels, far field ─> slabs, one after the other ─> MeshParts

No task of a tile does this. Each slab is a part as it comes, where a tile joins its slabs to one,
which takes more memory; and a cloud of one level has no coarse cells to make tiles of.
`all_tiles` gives the same surface, bit for bit.
"""

from __future__ import annotations

from functools import partial

from hpcapp.applications.surface.extraction.summary import summarize_part
from hpcapp.applications.surface.field.levels import SlabFields, fit_above
from hpcapp.applications.surface.field.pyramid import build_pyramid
from hpcapp.applications.surface.methods.method import Advance, ShowPart, show_nothing
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.applications.surface.tiles.halo import plan_whole
from hpcapp.applications.surface.tiles.plan import TilePlan
from hpcapp.applications.surface.tiles.slabs import cut_slabs, grow_slabs
from hpcapp.applications.surface.tiles.tasks import find_far, sample_cells
from hpcapp.geometry.points import PointCloud

SHOWN_SLABS = 8
"""At least, where somebody looks: of a quarter of a million points there are five. What they
overlap by makes the extraction of these a third longer, and no byte of the mesh another."""


def mesh_one_tile(
    cloud: PointCloud, plan: TilePlan, threads: int, advance: Advance, show_part: ShowPart
) -> tuple[Surface, int]:
    """Reconstruct the surface of a cloud with normals as one tile, in this process.

    `advance` is told (steps done, steps in all): the coarser levels, then each slab. The surface
    holds every brick that it reaches, each in one part; with it comes the count of its patches,
    the finest cells with points.
    """
    pyramid = build_pyramid(
        cloud, plan.origin, plan.cell_size, plan.height, threads, plan.refinement
    )
    kinds = plan_whole(plan.grid, cloud.positions)
    patches = len(pyramid.levels[0].cells)
    far = find_far(plan, sample_cells(pyramid.levels[plan.far]), threads)
    above, features, parents = fit_above(pyramid, plan.weights, None, far, threads)
    fields = SlabFields(pyramid, plan.weights, parents, above, features, far, plan.grid, threads)
    surface = Surface([], [], cloud.origin, points=len(cloud))
    bounds = cut_slabs(fields, kinds, 1 if show_part is show_nothing else SHOWN_SLABS)
    steps = len(bounds)  # one more than slabs
    advance(1, steps)
    for part, _ in grow_slabs(fields, kinds, bounds):
        surface.parts.append(part)
        surface.summaries.append(summarize_part(part))
        show_part(partial(surface.load, len(surface.parts) - 1))
        advance(min(1 + len(surface.parts), steps), steps)  # one without points has no part
    advance(steps, steps)
    return surface, patches
