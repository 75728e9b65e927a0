// Priors: the mean of the parents' quadrics, expressed about their children.
#include "arrays.h"
#include "clones.h"
#include "constants.h"
#include "lattice/keys.h"
#include "threads.h"

namespace hpc {
namespace {

using constants::BASIS;

using Quadric = double[BASIS];

// Express two quadrics about the place between them, half a cell above `lower` and below `upper`
// along an axis, and leave their mean in `lower`. Like moments (see moments.h), what an axis shifts
// evenly is seen in the sum, the rest in the difference.
HPC_INLINE void mean_pair(Quadric& lower, const Quadric& upper, int axis) {
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

// The mean of the parents at one height of a column of the lattice: two along each axis in which
// the column's coordinate is odd.
class Column {
 public:
  explicit Column(const Parents& parents)
      : parents_(parents), fingers_(4, Finger(parents.keys, parents.count)), sums_(parents.columns) {}

  // Find the mean for the column of a vertex, at a parent's height; return whether all are there.
  bool find(const Place& vertex, int64_t height) {
    const int odd = static_cast<int>((vertex[0] & 1) | (vertex[1] & 1) << 1);
    Quadric others[3];
    Quadric* quadrics[4] = {&quadric, &others[0], &others[1], &others[2]};
    std::fill(sums_.begin(), sums_.end(), 0.0);
    for (int corner = 0; corner < 4; ++corner) {
      if (corner & ~odd) continue;
      const Place parent{(vertex[0] + (corner & 1)) >> 1, (vertex[1] + (corner >> 1)) >> 1, height};
      const int64_t found = fingers_[corner].find(pack(parent));
      if (found < 0) return false;
      const float* coefficients = parents_.coefficients + found * BASIS;
      for (int i = 0; i < BASIS; ++i) (*quadrics[corner])[i] = coefficients[i];
      const float* values = parents_.values + found * parents_.columns;
      for (int64_t i = 0; i < parents_.columns; ++i) sums_[i] += values[i];
    }
    if (odd & 1) {
      mean_pair(quadric, others[0], 0);
      if (odd & 2) mean_pair(others[1], others[2], 0);
    }
    if (odd & 2) mean_pair(quadric, others[1], 1);
    share_ = 1.0 / (1 << ((odd & 1) + (odd >> 1)));
    return true;
  }

  double mean(int64_t value) const { return share_ * sums_[value]; }

  Quadric quadric;

 private:
  const Parents& parents_;
  std::vector<Finger> fingers_;
  std::vector<double> sums_;
  double share_ = 1.0;
};

// Return whether all parents are there: what is compiled several times must not throw. Of the
// columns one is for even heights, one for odd ones: a vertex and the next have one in common.
HPC_CLONES bool inherit_range(const int64_t* vertices, const Parents& parents, int64_t start, int64_t stop,
                              Column (&columns)[2], float* coefficients, float* inherited) {
  int64_t held[2] = {-1, -1};
  for (int64_t row = start; row < stop; ++row) {
    const Place place = unpack(vertices[row]);
    const int64_t heights[2] = {place[2] >> 1, (place[2] + 1) >> 1};
    Column* ends[2];
    for (int end = 0; end < 2; ++end) {
      const int64_t slot = heights[end] & 1, key = (vertices[row] & ~MASK) + heights[end] + BIAS;
      ends[end] = &columns[slot];
      if (held[slot] != key && !ends[end]->find(place, heights[end])) return false;
      held[slot] = key;
    }
    Quadric quadric;
    std::copy(ends[0]->quadric, ends[0]->quadric + BASIS, quadric);
    if (place[2] & 1) mean_pair(quadric, ends[1]->quadric, 2);
    // In cells of half the size: f((u + step) / 2) * 2.
    for (int i = 0; i < BASIS; ++i)
      coefficients[row * BASIS + i] = static_cast<float>((i == 0 ? 2.0 : i < 4 ? 1.0 : 0.5) * quadric[i]);
    for (int64_t i = 0; i < parents.columns; ++i)
      inherited[row * parents.columns + i] = static_cast<float>(0.5 * (ends[0]->mean(i) + ends[1]->mean(i)));
  }
  return true;
}

nb::tuple inherit_level(Integers vertices_of, Integers keys_of, Singles coefficients_of, Singles values_of,
                        int64_t threads) {
  const int64_t* vertices = check_keys(vertices_of, "vertices");
  const int64_t* keys = check_keys(keys_of, "parent_keys");
  const int64_t count = rows_of(vertices_of), known = rows_of(keys_of);
  const float* values = check<float>(values_of, "values", {known, ANY});
  const int64_t columns = static_cast<int64_t>(values_of.shape(1));
  const float* means = check<float>(coefficients_of, "coefficients", {known, BASIS});
  const Parents parents{keys, known, columns, means, values};
  const int workers = check_threads(threads);
  give_back_rest();  // of the level above, which was smaller
  auto coefficients = make_buffer<float>(count * BASIS);
  auto inherited = make_buffer<float>(count * columns);
  {
    const Unlocked unlocked;
    run_ranges(count, workers, [&](int64_t start, int64_t stop) {
      Column columns[2] = {Column(parents), Column(parents)};
      if (!inherit_range(vertices, parents, start, stop, columns, coefficients.get(), inherited.get()))
        refuse("parent_keys: a vertex has no parent there");
    });
  }
  const size_t rows = static_cast<size_t>(count);
  return nb::make_tuple(give(std::move(coefficients), {rows, BASIS}),
                        give(std::move(inherited), {rows, static_cast<size_t>(columns)}));
}

}  // namespace

HPC_KERNELS {
  module.def("inherit_level", &inherit_level, "vertices"_a, "parents"_a, "coefficients"_a, "values"_a,
             "threads"_a = 1);
}

}  // namespace hpc
