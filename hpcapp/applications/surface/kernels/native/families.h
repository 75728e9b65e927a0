// What the files of the extension show to one another.
#pragma once

#include "arrays.h"
#include "keys.h"

namespace hpc {

// Return the points' rows in the order of their cells, stably, and the cells' squeezed keys.
Ranking rank_points(const double* points, int64_t count, const double* origin, double size, Span& span);

// Find the cell of each point.
void find_places(const double* points, int64_t count, const double* origin, double size, Place* places);

// Express points relative to the centres of their cells, in cells.
void centre_points(double* points, int64_t count, const double* origin, double size);

// Check that cell i holds the points offsets[i] to offsets[i + 1], and that these are all.
const int64_t* check_offsets(const Input& offsets, int64_t cells, int64_t points);

// Faces whose vertices are all there.
const int64_t* check_faces(const Input& faces, int64_t vertices);

void bind_points(nb::module_& module);
void bind_packing(nb::module_& module);
void bind_lattice(nb::module_& module);
void bind_outliers(nb::module_& module);
void bind_neighbours(nb::module_& module);
void bind_moments(nb::module_& module);
void bind_hermite(nb::module_& module);
void bind_inheritance(nb::module_& module);
void bind_far_field(nb::module_& module);
void bind_poisson(nb::module_& module);
void bind_field(nb::module_& module);
void bind_surface(nb::module_& module);
void bind_topology(nb::module_& module);
void bind_robust(nb::module_& module);
void bind_seams(nb::module_& module);
void bind_balance(nb::module_& module);
void bind_features(nb::module_& module);
void bind_planes(nb::module_& module);
void bind_links(nb::module_& module);
void bind_sheets(nb::module_& module);
void bind_collapse(nb::module_& module);

}  // namespace hpc
