// The coarse grid of the far field, interpolated.
#include "clones.h"
#include "coarse_grid.h"
#include "families.h"

namespace hpc {
namespace {

// Places beyond this are as far as can be: the cast to an index is safe.
constexpr double FARTHEST = 1e12;

int64_t check_side(int64_t side) {
  if (side < 2 || side > 1024) refuse("nodes: expected 2 to 1024");
  return side;
}

Output<double> sample_grid(Input values_of, Doubles places_of) {
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

// Interpolate at the corners of a lattice, whose places are made as they are needed.
HPC_CLONES void sample_keys(const float* values, int64_t side, const int64_t* keys, int64_t count, const double* origin,
                            double spacing, double* samples) {
  for (int64_t i = 0; i < count; ++i) {
    const Place corner = unpack(keys[i]);
    double place[3], total = 0.0;
    for (int axis = 0; axis < 3; ++axis)
      place[axis] = std::min(std::max(origin[axis] + spacing * static_cast<double>(corner[axis]), -FARTHEST), FARTHEST);
    visit_corners(spot_of(place, side), side, [&](int64_t node, double weight) { total += weight * values[node]; });
    samples[i] = total;
  }
}

Output<double> sample_corners(Input values_of, Integers keys_of, Doubles origin_of, double spacing) {
  const int64_t side = check_side(values_of.ndim() == 3 ? rows_of(values_of) : 0);
  const float* values = check<float>(values_of, "values", {side, side, side});
  const int64_t* keys = check_keys(keys_of, "keys");
  const double* origin = check<double>(origin_of, "origin", {3});
  const int64_t count = rows_of(keys_of);
  check_finite(origin, 3, "origin");
  check_positive(spacing, "spacing");
  auto samples = make_buffer<double>(count);
  {
    nb::gil_scoped_release unlocked;
    sample_keys(values, side, keys, count, origin, spacing, samples.get());
  }
  return give(std::move(samples), {static_cast<size_t>(count)});
}

}  // namespace

void bind_far_field(nb::module_& module) {
  module.def("sample_corners", &sample_corners, "values"_a, "keys"_a, "origin"_a, "spacing"_a);
  module.def("sample_grid", &sample_grid, "values"_a, "places"_a);
}

}  // namespace hpc
