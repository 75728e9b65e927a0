// Priors: the mean of the parents' quadrics, expressed about their children.
#include "families.h"
#include "keys.h"
#include "threads.h"

namespace hpc {
namespace {

constexpr int BASIS = 10;

using Quadric = double[BASIS];

// Express two quadrics about the place between them, half a cell above `lower` and below `upper`
// along an axis, and leave their mean in `lower`. Like moments (see moments.h), what an axis shifts
// evenly is seen in the sum, the rest in the difference.
inline void mean_pair(Quadric& lower, const Quadric& upper, int axis) {
  // The square of the axis, and its products with the next axis and with the one after that.
  const int next = (axis + 1) % 3, last = (axis + 2) % 3;
  const int linear = 1 + axis, square = 4 + axis, with_next = 7 + axis, with_last = 7 + last;
  const auto half_difference = [&](int i) { return 0.5 * (lower[i] - upper[i]); };
  const double slope = half_difference(linear), bend = half_difference(square);
  const double twist_next = half_difference(with_next), twist_last = half_difference(with_last);
  for (int i = 0; i < BASIS; ++i) lower[i] = 0.5 * (lower[i] + upper[i]);
  lower[0] += 0.5 * slope + 0.25 * lower[square];
  lower[linear] += bend;
  lower[1 + next] += 0.5 * twist_next;
  lower[1 + last] += 0.5 * twist_last;
}

struct Parents {
  const int64_t* keys;
  int64_t count, columns;
  const float *coefficients, *values;
};

void inherit_range(const int64_t* vertices, const Parents& parents, int64_t start, int64_t stop,
                   float* coefficients, float* inherited) {
  std::vector<double> means(parents.columns);
  std::vector<Finger> fingers(8, Finger(parents.keys, parents.count));
  Quadric quadrics[8];
  for (int64_t row = start; row < stop; ++row) {
    std::fill(means.begin(), means.end(), 0.0);
    const Place place = unpack(vertices[row]);
    int odd = 0;
    for (int axis = 0; axis < 3; ++axis) odd |= static_cast<int>(place[axis] & 1) << axis;
    // The two parents along an axis with an even coordinate are one.
    const double weight = 1.0 / (1 << ((odd & 1) + (odd >> 1 & 1) + (odd >> 2)));
    for (int octant = 0; octant < 8; ++octant) {
      if (octant & ~odd) continue;
      Place parent;
      for (int axis = 0; axis < 3; ++axis) parent[axis] = (place[axis] + (octant >> axis & 1)) >> 1;
      const int64_t found = fingers[octant].find(pack(parent));
      if (found < 0) refuse("parent_keys: a vertex has no parent there");
      for (int i = 0; i < BASIS; ++i) quadrics[octant][i] = parents.coefficients[found * BASIS + i];
      const float* values = parents.values + found * parents.columns;
      for (int64_t i = 0; i < parents.columns; ++i) means[i] += weight * values[i];
    }
    for (int axis = 0, left = odd; axis < 3; ++axis) {
      if (!(odd >> axis & 1)) continue;
      left &= ~(1 << axis);
      for (int octant = 0; octant < 8; ++octant)
        if (!(octant & ~left)) mean_pair(quadrics[octant], quadrics[octant | 1 << axis], axis);
    }
    // In cells of half the size: f((u + step) / 2) * 2.
    for (int i = 0; i < BASIS; ++i)
      coefficients[row * BASIS + i] = static_cast<float>((i == 0 ? 2.0 : i < 4 ? 1.0 : 0.5) * quadrics[0][i]);
    for (int64_t i = 0; i < parents.columns; ++i)
      inherited[row * parents.columns + i] = static_cast<float>(means[i]);
  }
}

nb::tuple inherit_level(Input vertices_of, Input keys_of, Input coefficients_of, Input values_of,
                        int64_t threads) {
  const int64_t* vertices = check_keys(vertices_of, "vertices");
  const int64_t* keys = check_keys(keys_of, "parent_keys");
  const int64_t count = rows_of(vertices_of), known = rows_of(keys_of);
  const float* values = check<float>(values_of, "values", {known, ANY});
  const int64_t columns = static_cast<int64_t>(values_of.shape(1));
  const float* means = check<float>(coefficients_of, "coefficients", {known, BASIS});
  const Parents parents{keys, known, columns, means, values};
  const int workers = check_threads(threads);
  auto coefficients = make_buffer<float>(count * BASIS);
  auto inherited = make_buffer<float>(count * columns);
  {
    nb::gil_scoped_release unlocked;
    run_ranges(count, workers, [&](int64_t start, int64_t stop) {
      inherit_range(vertices, parents, start, stop, coefficients.get(), inherited.get());
    });
  }
  const size_t rows = static_cast<size_t>(count);
  return nb::make_tuple(give(std::move(coefficients), {rows, BASIS}),
                        give(std::move(inherited), {rows, static_cast<size_t>(columns)}));
}

}  // namespace

void bind_inheritance(nb::module_& module) { module.def("inherit_level", &inherit_level); }

}  // namespace hpc
