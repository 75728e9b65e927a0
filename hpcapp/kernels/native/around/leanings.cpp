// Values of nodes that are known at some, and follow over links elsewhere (see around/leanings.py).
#include <algorithm>

#include "arrays.h"
#include "clones.h"

namespace hpc {
namespace {

constexpr int LANES = 8;
constexpr int64_t MOST_STEPS = 1 << 20;

// A sparse matrix, in groups of eight rows: of each row, by rising columns, what is not 0, and then 0
// as far as the longest of its group. So lanes are rows.
struct Matrix {
  int64_t rows;
  Large<int64_t> offsets;  // group g holds the steps offsets[g] to offsets[g + 1], a value of each row
  Large<int32_t> column;
  Large<double> value;
};

HPC_CLONES void multiply(const int64_t* offsets, int64_t groups, const int32_t* column, const double* value,
                         const double* vector, double* product) {
  for (int64_t group = 0; group < groups; ++group) {
    double sums[LANES] = {};
    for (int64_t i = LANES * offsets[group]; i < LANES * offsets[group + 1]; i += LANES)
      HPC_LANES
      for (int lane = 0; lane < LANES; ++lane) sums[lane] += value[i + lane] * vector[column[i + lane]];
    for (int lane = 0; lane < LANES; ++lane) product[LANES * group + lane] = sums[lane];
  }
}

// Links are sorted by both ends: so the columns of each row rise.
Matrix make_matrix(const int64_t* first, const int64_t* second, const double* strengths, int64_t links,
                   const double* diagonal, int64_t count) {
  const int64_t groups = (count + LANES - 1) / LANES;
  Large<int64_t> next(static_cast<size_t>(LANES * groups), 0);
  for (int64_t i = 0; i < links; ++i) ++next[first[i]], ++next[second[i]];
  Matrix matrix{count, {0}, {}, {}};
  for (int64_t group = 0; group < groups; ++group) {
    const int64_t longest = *std::max_element(&next[LANES * group], &next[LANES * group] + LANES) + 1;
    matrix.offsets.push_back(matrix.offsets[group] + longest);
    for (int lane = 0; lane < LANES; ++lane) next[LANES * group + lane] = LANES * matrix.offsets[group] + lane;
  }
  matrix.column.resize(static_cast<size_t>(LANES * matrix.offsets[groups]), 0);
  matrix.value.resize(matrix.column.size(), 0.0);
  const auto add = [&](int64_t row, int64_t column, double value) {
    matrix.column[next[row]] = static_cast<int32_t>(column);
    matrix.value[next[row]] = value;
    next[row] += LANES;
  };
  for (int64_t i = 0; i < links; ++i) add(second[i], first[i], -strengths[i]);
  for (int64_t row = 0; row < count; ++row) add(row, row, diagonal[row]);
  for (int64_t i = 0; i < links; ++i) add(first[i], second[i], -strengths[i]);
  return matrix;
}

HPC_CLONES double dot(const double* a, const double* b, int64_t count) {
  double lanes[LANES] = {};
  int64_t i = 0;
  for (; i + LANES <= count; i += LANES)
    HPC_LANES
    for (int lane = 0; lane < LANES; ++lane) lanes[lane] += a[i + lane] * b[i + lane];
  for (int lane = 0; i < count; ++i, ++lane) lanes[lane] += a[i] * b[i];
  double sum = 0.0;
  for (int lane = 0; lane < LANES; ++lane) sum += lanes[lane];
  return sum;
}

// Add a multiple of one vector to another.
HPC_CLONES void add(double factor, const double* more, int64_t count, double* vector) {
  HPC_LANES
  for (int64_t i = 0; i < count; ++i) vector[i] += factor * more[i];
}

HPC_CLONES void divide(const double* a, const double* b, int64_t count, double* quotient) {
  HPC_LANES
  for (int64_t i = 0; i < count; ++i) quotient[i] = a[i] / b[i];
}

// Make a vector another one and a multiple of itself.
HPC_CLONES void turn(double factor, const double* other, int64_t count, double* vector) {
  HPC_LANES
  for (int64_t i = 0; i < count; ++i) vector[i] = other[i] + factor * vector[i];
}

void solve(const Matrix& matrix, const double* diagonal, const double* known, double tolerance, int64_t most,
           double* values) {
  const int64_t count = matrix.rows, groups = static_cast<int64_t>(matrix.offsets.size()) - 1;
  const double bound = tolerance * tolerance * dot(known, known, count);
  if (!(bound > 0.0)) {
    std::fill_n(values, count, 0.0);
    return;
  }
  Large<double> residual(known, known + count), scaled(residual.size()), direction(residual.size(), 0.0),
      product(static_cast<size_t>(LANES * groups));
  const auto apply = [&](const double* vector) {
    multiply(matrix.offsets.data(), groups, matrix.column.data(), matrix.value.data(), vector, product.data());
  };
  apply(values);
  add(-1.0, product.data(), count, residual.data());
  double last = 1.0;
  for (int64_t step = 0; step < most && !(dot(residual.data(), residual.data(), count) < bound); ++step) {
    poll();
    divide(residual.data(), diagonal, count, scaled.data());
    const double fall = dot(residual.data(), scaled.data(), count);
    if (!(fall > 0.0)) break;
    turn(fall / last, scaled.data(), count, direction.data());
    apply(direction.data());
    const double length = fall / dot(direction.data(), product.data(), count);
    add(length, direction.data(), count, values);
    add(-length, product.data(), count, residual.data());
    last = fall;
  }
}

Output<double> spread_leanings(Integers first_of, Integers second_of, Doubles strengths_of, Doubles sums_of,
                               Doubles known_of, Doubles start_of, double tolerance, int64_t most) {
  const double* sums = check<double>(sums_of, "sums", {ANY});
  const int64_t count = rows_of(sums_of), links = rows_of(first_of);
  const int64_t* first = check_rows(first_of, "first", count);
  const int64_t* second = check_rows(second_of, "second", count);
  if (rows_of(second_of) != links) refuse("second: expected another shape");
  const double* strengths = check<double>(strengths_of, "strengths", {links});
  const double* known = check<double>(known_of, "known", {count});
  const double* start = check<double>(start_of, "start", {count});
  if (count >= INT32_MAX) refuse("sums: too many nodes");
  if (most < 0 || most > MOST_STEPS) refuse("most: expected 0 to 2^20");
  Buffer<double> values;
  {
    const Unlocked unlocked;
    values = make_buffer<double>(count);
    std::copy_n(start, count, values.get());
    const Matrix matrix = make_matrix(first, second, strengths, links, sums, count);
    solve(matrix, sums, known, tolerance, most, values.get());
  }
  return give(std::move(values), {static_cast<size_t>(count)});
}

}  // namespace

HPC_KERNELS {
  module.def("spread_leanings", &spread_leanings, "first"_a, "second"_a, "strengths"_a, "sums"_a, "known"_a, "start"_a,
             "tolerance"_a, "most"_a);
}

}  // namespace hpc
