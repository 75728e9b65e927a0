"""The kernels in C++: each checks and converts its arrays, and calls the extension.

Each function has its full description at the one of the same name in `portable`.
"""

from hpccomponent.surface.kernels.native.extraction import (
    balance_vertices,
    evaluate_bricks,
    grow_surface,
    seed_bricks,
)
from hpccomponent.surface.kernels.native.far_field import (
    integrate_normals,
    sample_corners,
    sample_grid,
)
from hpccomponent.surface.kernels.native.fitting import (
    accumulate_moments,
    corner_moments,
    evaluate_residuals,
    fit_corners,
    fit_features,
    inherit_level,
    merge_cells,
    rate_points,
)
from hpccomponent.surface.kernels.native.keys import (
    find_keys,
    look_near,
    mark_ancestors,
    mark_near,
    parent_keys,
    spread_keys,
    unite_keys,
)
from hpccomponent.surface.kernels.native.memory import bound_free_memory, keep_memory
from hpccomponent.surface.kernels.native.mesh import (
    find_seams,
    label_components,
    signed_volume,
    sum_bricks,
    survey_mesh,
)
from hpccomponent.surface.kernels.native.packing import (
    count_packed,
    pack_records,
    place_packed,
    seed_packed,
    sort_packed,
    unpack_records,
    unpack_within,
)
from hpccomponent.surface.kernels.native.points import (
    bound_points,
    count_boxes,
    count_cells,
    gather_points,
    label_cells,
    poll_normals,
    sample_boxes,
    sort_points,
    sum_neighbours,
    take_cells,
)

__all__ = [
    "accumulate_moments", "balance_vertices", "bound_free_memory", "bound_points",
    "corner_moments", "count_boxes", "count_cells", "count_packed", "evaluate_bricks",
    "evaluate_residuals", "find_keys", "find_seams", "fit_corners", "fit_features", "gather_points",
    "grow_surface", "inherit_level", "integrate_normals", "keep_memory", "label_cells",
    "label_components", "look_near", "mark_ancestors", "mark_near", "merge_cells", "pack_records",
    "parent_keys", "place_packed", "poll_normals", "rate_points", "sample_boxes",
    "sample_corners", "sample_grid", "seed_bricks", "seed_packed", "signed_volume", "sort_packed",
    "sort_points", "spread_keys", "sum_bricks", "sum_neighbours", "survey_mesh", "take_cells",
    "unite_keys", "unpack_records", "unpack_within",
]  # fmt: skip
