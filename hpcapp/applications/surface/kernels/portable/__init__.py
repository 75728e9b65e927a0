"""The kernels in numpy: the specification of the native ones, and what runs without a compiler."""

from hpcapp.applications.surface.kernels.portable.around.links import (
    link_groups,
)
from hpcapp.applications.surface.kernels.portable.around.planes import (
    fit_planes,
)
from hpcapp.applications.surface.kernels.portable.around.sheets import (
    group_sheets,
)
from hpcapp.applications.surface.kernels.portable.around.sparse import (
    find_nearest,
    find_sparse,
)
from hpcapp.applications.surface.kernels.portable.bricks import (
    seed_bricks,
)
from hpcapp.applications.surface.kernels.portable.cells import (
    corner_moments,
    fit_corners,
    gather_points,
    inherit_level,
    merge_cells,
    parent_keys,
    sort_points,
)
from hpcapp.applications.surface.kernels.portable.coarse_grid import (
    integrate_normals,
    sample_corners,
    sample_grid,
)
from hpcapp.applications.surface.kernels.portable.collapse import (
    collapse_edges,
)
from hpcapp.applications.surface.kernels.portable.connectivity import (
    find_seams,
    label_components,
    signed_volume,
    sum_bricks,
    survey_mesh,
)
from hpcapp.applications.surface.kernels.portable.counting import (
    bound_points,
    count_boxes,
    count_cells,
    label_cells,
    sample_boxes,
    sum_neighbours,
)
from hpcapp.applications.surface.kernels.portable.features import (
    fit_features,
)
from hpcapp.applications.surface.kernels.portable.field import (
    evaluate_bricks,
)
from hpcapp.applications.surface.kernels.portable.hermite import (
    evaluate_residuals,
)
from hpcapp.applications.surface.kernels.portable.keys import (
    find_keys,
    look_near,
    mark_ancestors,
    mark_near,
    spread_keys,
    unite_keys,
)
from hpcapp.applications.surface.kernels.portable.marching_cubes import (
    balance_vertices,
    grow_surface,
)
from hpcapp.applications.surface.kernels.portable.memory import (
    bound_free_memory,
    keep_memory,
)
from hpcapp.applications.surface.kernels.portable.moments import (
    accumulate_moments,
)
from hpcapp.applications.surface.kernels.portable.normals import (
    poll_normals,
)
from hpcapp.applications.surface.kernels.portable.packing import (
    count_packed,
    pack_records,
    place_packed,
    seed_packed,
    sort_packed,
    unpack_records,
    unpack_within,
)
from hpcapp.applications.surface.kernels.portable.robust import (
    rate_points,
)

__all__ = [
    "accumulate_moments", "balance_vertices", "bound_free_memory", "bound_points",
    "collapse_edges", "corner_moments",
    "count_boxes", "count_cells", "count_packed", "evaluate_bricks", "evaluate_residuals",
    "find_keys", "find_nearest", "find_seams", "find_sparse", "fit_corners", "fit_features",
    "fit_planes", "gather_points", "group_sheets", "grow_surface", "inherit_level",
    "integrate_normals", "keep_memory", "label_cells", "label_components", "link_groups",
    "look_near", "mark_ancestors", "mark_near", "merge_cells", "pack_records", "parent_keys",
    "place_packed", "poll_normals", "rate_points", "sample_boxes", "sample_corners", "sample_grid",
    "seed_bricks", "seed_packed", "signed_volume", "sort_packed", "sort_points", "spread_keys",
    "sum_bricks", "sum_neighbours", "survey_mesh",
    "unite_keys", "unpack_records", "unpack_within",
]  # fmt: skip
