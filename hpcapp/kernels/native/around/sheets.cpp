// Points of one cell on one sheet, whose normals agree up to their signs (see around/sheets.py).
#include <cmath>

#include "constants.h"
#include "lattice/points.h"
#include "threads.h"

namespace hpc {
namespace {

using namespace constants::sheets;
using constants::SHEETS;

// A point of the cell that is grouped.
struct SheetPoint {
  uint32_t row;
  double position[3], normal[3], thick;
};

inline double dot(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

SheetPoint make_point(const double* positions, const float* vectors, double spacing, uint32_t row) {
  SheetPoint point{row, {}, {}, 0.0};
  const int64_t at = 3 * static_cast<int64_t>(row);
  for (int axis = 0; axis < 3; ++axis) {
    point.position[axis] = positions[at + axis];
    point.normal[axis] = static_cast<double>(vectors[at + axis]);
  }
  const double noise = std::sqrt(dot(point.normal, point.normal)), length = std::max(noise, 1e-300);
  for (double& coordinate : point.normal) coordinate /= length;
  point.thick = std::max(THICK * spacing, NOISES * noise);
  return point;
}

// Return which point is nearest to the middle of all; of several as near, the first.
size_t find_seed(const std::vector<SheetPoint>& points, std::vector<double>& squares) {
  double middle[3] = {0.0, 0.0, 0.0}, nearest = INFINITY;
  for (const SheetPoint& point : points)
    for (int axis = 0; axis < 3; ++axis) middle[axis] += point.position[axis];
  for (double& coordinate : middle) coordinate /= static_cast<double>(points.size());
  squares.clear();
  for (const SheetPoint& point : points) {
    double arm[3];
    for (int axis = 0; axis < 3; ++axis) arm[axis] = point.position[axis] - middle[axis];
    squares.push_back(dot(arm, arm));
    nearest = std::min(nearest, squares.back());
  }
  for (size_t i = 0; i < points.size(); ++i)
    if (squares[i] <= TIED * nearest) return i;
  return 0;
}

// Group the points of a cell; return how many groups there are.
int group_cell(std::vector<SheetPoint>& left, std::vector<double>& squares, int64_t* rank_of, uint8_t* opposed) {
  int rank = 0;
  for (; !left.empty(); ++rank) {
    const size_t at = find_seed(left, squares);
    const SheetPoint seed = left[at];
    size_t kept = 0;
    for (size_t i = 0; i < left.size(); ++i) {
      const SheetPoint point = left[i];
      double arm[3];
      for (int axis = 0; axis < 3; ++axis) arm[axis] = point.position[axis] - seed.position[axis];
      const double cosine = dot(point.normal, seed.normal);
      const bool is_on = std::abs(dot(arm, seed.normal)) <= point.thick &&
                         std::abs(dot(arm, point.normal)) <= point.thick && std::abs(cosine) >= AGREE;
      if (is_on || i == at || rank == SHEETS - 1) {
        rank_of[point.row] = rank;
        opposed[point.row] = cosine < 0.0;
      } else {
        left[kept++] = point;
      }
    }
    left.resize(kept);
  }
  return rank;
}

nb::tuple group_sheets(Doubles positions, Singles vectors_of, Doubles low_of, double edge, double spacing,
                       int64_t threads) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const int64_t count = rows_of(positions);
  const float* vectors = check<float>(vectors_of, "vectors", {count, 3});
  const double* low = check<double>(low_of, "low", {3});
  check_positive(edge, "edge");
  check_positive(spacing, "spacing");
  if (!count || count >= INT32_MAX) refuse("positions: expected 1 to 2^31 - 1 points");
  const int workers = check_threads(threads);
  Large<int64_t> keys, ranks;
  Buffer<int64_t> group_of;
  Buffer<uint8_t> opposed;
  {
    const Unlocked unlocked;
    Span span({0, 0, 0}, {0, 0, 0});
    const Ranking ranked = rank_points(point, count, low, edge, span);
    Large<int64_t> starts;
    for (int64_t i = 0; i < count; ++i)
      if (ranked.begins(i)) starts.push_back(i);
    const int64_t cells = static_cast<int64_t>(starts.size());
    starts.push_back(count);
    group_of = make_buffer<int64_t>(count);
    opposed = make_buffer<uint8_t>(count);
    Large<int> groups(static_cast<size_t>(cells));
    run_ranges(cells, workers, [&](int64_t start, int64_t stop) {
      std::vector<SheetPoint> left;
      std::vector<double> squares;
      for (int64_t cell = start; cell < stop; ++cell) {
        for (int64_t i = starts[cell]; i < starts[cell + 1]; ++i)
          left.push_back(make_point(point, vectors, spacing, ranked.row(i)));
        groups[cell] = group_cell(left, squares, group_of.get(), opposed.get());
      }
    });
    for (int64_t cell = 0; cell < cells; ++cell) {
      const int64_t first = static_cast<int64_t>(keys.size()), key = pack(span.restore(ranked.key(starts[cell])));
      for (int64_t i = starts[cell]; i < starts[cell + 1]; ++i) group_of[ranked.row(i)] += first;
      for (int rank = 0; rank < groups[cell]; ++rank) {
        keys.push_back(key);
        ranks.push_back(rank);
      }
    }
  }
  const size_t n = static_cast<size_t>(count);
  return nb::make_tuple(give(std::move(keys)), give(std::move(ranks)), give(std::move(group_of), {n}),
                        give(std::move(opposed), {n}));
}

}  // namespace

HPC_KERNELS {
  module.def("group_sheets", &group_sheets, "positions"_a, "vectors"_a, "low"_a, "edge"_a, "spacing"_a,
             "threads"_a = 1);
}

}  // namespace hpc
