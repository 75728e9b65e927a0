// Values of nodes that are known at some, and follow over links elsewhere (see around/leanings.py).
#include <algorithm>

#include "arrays.h"
#include "clones.h"

namespace hpc {
namespace {

constexpr int LANES = 8;
constexpr int64_t MOST_STEPS = 1 << 20;

// A symmetric matrix: of each row what is not on the diagonal, by rising columns.
struct Matrix {
  Large<int64_t> offsets;
  Large<uint32_t> column;
  Large<double> value;
  const double* diagonal;

  int64_t rows() const { return static_cast<int64_t>(offsets.size()) - 1; }

  // Multiply a vector, row by row: what is below the diagonal first, then this, then what is above.
  void multiply(const double* vector, double* product) const {
    for (int64_t row = 0; row < rows(); ++row) {
      double sum = 0.0;
      int64_t i = offsets[row];
      for (; i < offsets[row + 1] && column[i] < row; ++i) sum -= value[i] * vector[column[i]];
      sum += diagonal[row] * vector[row];
      for (; i < offsets[row + 1]; ++i) sum -= value[i] * vector[column[i]];
      product[row] = sum;
    }
  }
};

Matrix make_matrix(const int64_t* first, const int64_t* second, const double* strengths, int64_t links,
                   const double* diagonal, int64_t count) {
  Matrix matrix{Large<int64_t>(static_cast<size_t>(count) + 1, 0), {}, {}, diagonal};
  for (int64_t i = 0; i < links; ++i) ++matrix.offsets[first[i] + 1], ++matrix.offsets[second[i] + 1];
  for (int64_t row = 0; row < count; ++row) matrix.offsets[row + 1] += matrix.offsets[row];
  matrix.column.resize(static_cast<size_t>(2 * links));
  matrix.value.resize(static_cast<size_t>(2 * links));
  Large<int64_t> next(matrix.offsets.begin(), matrix.offsets.end() - 1);
  const auto add = [&](int64_t row, int64_t column, double value) {
    const int64_t at = next[row]++;
    matrix.column[at] = static_cast<uint32_t>(column);
    matrix.value[at] = value;
  };
  // Links are sorted by both ends: so the columns of each row rise.
  for (int64_t i = 0; i < links; ++i) add(second[i], first[i], strengths[i]);
  for (int64_t i = 0; i < links; ++i) add(first[i], second[i], strengths[i]);
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

void solve(const Matrix& matrix, const double* known, double tolerance, int64_t most, double* values) {
  const int64_t count = matrix.rows();
  const size_t room = static_cast<size_t>(count);
  const double bound = tolerance * tolerance * dot(known, known, count);
  if (!(bound > 0.0)) {
    std::fill_n(values, count, 0.0);
    return;
  }
  Large<double> residual(known, known + count), scaled(room), direction(room, 0.0), product(room);
  matrix.multiply(values, product.data());
  add(-1.0, product.data(), count, residual.data());
  double last = 1.0;
  for (int64_t step = 0; step < most && !(dot(residual.data(), residual.data(), count) < bound); ++step) {
    divide(residual.data(), matrix.diagonal, count, scaled.data());
    const double fall = dot(residual.data(), scaled.data(), count);
    if (!(fall > 0.0)) break;
    turn(fall / last, scaled.data(), count, direction.data());
    matrix.multiply(direction.data(), product.data());
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
  if (count >= UINT32_MAX) refuse("sums: too many nodes");
  if (most < 0 || most > MOST_STEPS) refuse("most: expected 0 to 2^20");
  Buffer<double> values;
  {
    nb::gil_scoped_release unlocked;
    values = make_buffer<double>(count);
    std::copy_n(start, count, values.get());
    const Matrix matrix = make_matrix(first, second, strengths, links, sums, count);
    solve(matrix, known, tolerance, most, values.get());
  }
  return give(std::move(values), {static_cast<size_t>(count)});
}

}  // namespace

HPC_KERNELS {
  module.def("spread_leanings", &spread_leanings, "first"_a, "second"_a, "strengths"_a, "sums"_a, "known"_a, "start"_a,
             "tolerance"_a, "most"_a);
}

}  // namespace hpc
