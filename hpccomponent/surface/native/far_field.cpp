// The coarse grid of the far field: spreading samples on it, and interpolating it.
#include "families.h"

namespace hpc {
namespace {

// The lower node of a place, and how far beyond it the place lies; as trilinear weights need it.
struct Spot {
  int64_t node;
  double local[3];
};

inline Spot spot_of(const double* place, int64_t side) {
  Spot spot{0, {0, 0, 0}};
  for (int axis = 0; axis < 3; ++axis) {
    const double lower = std::min(std::max(std::floor(place[axis]), 0.0), static_cast<double>(side - 2));
    spot.node = spot.node * side + static_cast<int64_t>(lower);
    spot.local[axis] = place[axis] - lower;
  }
  return spot;
}

// Call body(node, weight) for the eight nodes around a place.
template <class Body>
inline void visit_corners(const Spot& spot, int64_t side, const Body& body) {
  for (int octant = 0; octant < 8; ++octant) {
    double factor[3];
    for (int axis = 0; axis < 3; ++axis)
      factor[axis] = (octant >> axis & 1) ? spot.local[axis] : 1.0 - spot.local[axis];
    const int64_t step = ((octant & 1) * side + (octant >> 1 & 1)) * side + (octant >> 2);
    body(spot.node + step, factor[0] * factor[1] * factor[2]);
  }
}

int64_t check_side(int64_t side) {
  if (side < 2 || side > 1024) refuse("nodes: expected 2 to 1024");
  return side;
}

// One component at a time: its grid is all the memory that it takes.
Output<float> spread_component(Input places_of, Input normals_of, int64_t axis, int64_t nodes) {
  const double* places = check<double>(places_of, "places", {ANY, 3});
  const int64_t count = rows_of(places_of), side = check_side(nodes);
  const double* normals = check<double>(normals_of, "normals", {count, 3});
  if (axis < 0 || axis > 2) refuse("axis: expected 0, 1 or 2");
  check_finite(places, 3 * count, "places");
  auto grid = make_buffer<float>(side * side * side);
  {
    nb::gil_scoped_release unlocked;
    std::fill(grid.get(), grid.get() + side * side * side, 0.0f);
    for (int64_t i = 0; i < count; ++i) {
      const double value = normals[3 * i + axis];
      visit_corners(spot_of(places + 3 * i, side), side, [&](int64_t node, double weight) {
        grid[node] += static_cast<float>(weight * value);
      });
    }
  }
  const size_t s = static_cast<size_t>(side);
  return give(std::move(grid), {s, s, s});
}

Output<double> sample_grid(Input values_of, Input places_of) {
  const int64_t side = check_side(values_of.ndim() == 3 ? rows_of(values_of) : 0);
  const float* values = check<float>(values_of, "values", {side, side, side});
  const double* places = check<double>(places_of, "places", {ANY, 3});
  const int64_t count = rows_of(places_of);
  check_finite(places, 3 * count, "places");
  auto samples = make_buffer<double>(count);
  {
    nb::gil_scoped_release unlocked;
    for (int64_t i = 0; i < count; ++i) {
      double total = 0.0;
      visit_corners(spot_of(places + 3 * i, side), side,
                    [&](int64_t node, double weight) { total += weight * values[node]; });
      samples[i] = total;
    }
  }
  return give(std::move(samples), {static_cast<size_t>(count)});
}

}  // namespace

void bind_far_field(nb::module_& module) {
  module.def("spread_component", &spread_component);
  module.def("sample_grid", &sample_grid);
}

}  // namespace hpc
