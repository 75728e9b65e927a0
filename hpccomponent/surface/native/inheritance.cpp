// Priors: the mean of the parents' quadrics, expressed about their children.
#include "families.h"
#include "keys.h"
#include "threads.h"

namespace hpc {
namespace {

constexpr int BASIS = 10;

// Add weight * 2 f((u + step) / 2) to a child's quadric.
template <class T>
inline void add_inherited(const T* c, const double* step, double weight, double* child) {
  const double x = step[0], y = step[1], z = step[2];
  const double linear = c[1] * x + c[2] * y + c[3] * z;
  const double square = c[4] * (x * x) + c[5] * (y * y) + c[6] * (z * z);
  const double mixed = c[7] * (x * y) + c[8] * (y * z) + c[9] * (z * x);
  child[0] += weight * (2.0 * c[0] + linear + 0.5 * (square + mixed));
  child[1] += weight * (c[1] + c[4] * x + 0.5 * (c[7] * y + c[9] * z));
  child[2] += weight * (c[2] + c[5] * y + 0.5 * (c[7] * x + c[8] * z));
  child[3] += weight * (c[3] + c[6] * z + 0.5 * (c[8] * y + c[9] * x));
  for (int i = 4; i < BASIS; ++i) child[i] += weight * (0.5 * c[i]);
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
  for (int64_t row = start; row < stop; ++row) {
    double child[BASIS] = {};
    std::fill(means.begin(), means.end(), 0.0);
    const Place place = unpack(vertices[row]);
    int odd = 0;
    for (int axis = 0; axis < 3; ++axis) odd |= static_cast<int>(place[axis] & 1) << axis;
    // The two parents along an axis with an even coordinate are one.
    const double weight = 1.0 / (1 << ((odd & 1) + (odd >> 1 & 1) + (odd >> 2)));
    for (int octant = 0; octant < 8; ++octant) {
      if (octant & ~odd) continue;
      Place parent;
      double step[3];
      for (int axis = 0; axis < 3; ++axis) {
        parent[axis] = (place[axis] + (octant >> axis & 1)) >> 1;
        step[axis] = static_cast<double>(place[axis] - 2 * parent[axis]);
      }
      const int64_t found = fingers[octant].find(pack(parent));
      if (found < 0) refuse("parent_keys: a vertex has no parent there");
      add_inherited(parents.coefficients + found * BASIS, step, weight, child);
      const float* values = parents.values + found * parents.columns;
      for (int64_t i = 0; i < parents.columns; ++i) means[i] += weight * values[i];
    }
    for (int i = 0; i < BASIS; ++i) coefficients[row * BASIS + i] = static_cast<float>(child[i]);
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

Output<double> inherit_quadrics(Input parents_of, Input steps_of) {
  const double* parents = check<double>(parents_of, "parents", {ANY, BASIS});
  const int64_t count = rows_of(parents_of);
  const int64_t* steps = check<int64_t>(steps_of, "steps", {count, 3});
  auto children = make_buffer<double>(count * BASIS);
  for (int64_t row = 0; row < count; ++row) {
    double* child = children.get() + row * BASIS;
    std::fill(child, child + BASIS, 0.0);
    double step[3];
    for (int axis = 0; axis < 3; ++axis) step[axis] = static_cast<double>(steps[3 * row + axis]);
    add_inherited(parents + row * BASIS, step, 1.0, child);
  }
  return give(std::move(children), {static_cast<size_t>(count), BASIS});
}

}  // namespace

void bind_inheritance(nb::module_& module) {
  module.def("inherit_level", &inherit_level);
  module.def("inherit_quadrics", &inherit_quadrics);
}

}  // namespace hpc
