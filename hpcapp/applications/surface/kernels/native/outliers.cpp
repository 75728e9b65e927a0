// Points that do not belong and normals that point the wrong way (see counting.py, normals.py).
#include "families.h"
#include "threads.h"

namespace hpc {
namespace {

// The occupied cells around a cell, in the order of their keys: at most 27 rows.
class Neighbourhood {
 public:
  Neighbourhood(const int64_t* keys, int64_t count) : keys_(keys), count_(count) {
    fingers_.assign(9, Finger(keys, count));
  }

  // Return how many rows were found around `key`; they are in `rows`.
  int gather(int64_t key) {
    int found = 0;
    for (int column = 0; column < 9; ++column) {
      const int64_t middle = key + (column / 3 - 1) * STRIDES[0] + (column % 3 - 1) * STRIDES[1];
      int64_t row = fingers_[static_cast<size_t>(column)].lower_bound(middle - 1);
      for (; row < count_ && keys_[row] <= middle + 1; ++row) rows[found++] = row;
    }
    return found;
  }

  int64_t rows[27];

 private:
  const int64_t* keys_;
  int64_t count_;
  std::vector<Finger> fingers_;  // one for each column of cells: each walks on as the keys rise
};

nb::tuple count_cells(Doubles positions, Doubles origin_of, double edge) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const double* origin = check<double>(origin_of, "origin", {3});
  check_positive(edge, "edge");
  const int64_t count = rows_of(positions);
  if (!count || count >= UINT32_MAX) refuse("positions: expected 1 to 2^32 - 1 points");
  Large<int64_t> cells, counts;
  Buffer<int64_t> cell_of;
  {
    nb::gil_scoped_release unlocked;
    Span span({0, 0, 0}, {0, 0, 0});
    const Ranking ranked = rank_points(point, count, origin, edge, span);
    cell_of = make_buffer<int64_t>(count);
    for (int64_t i = 0; i < count; ++i) {
      if (ranked.begins(i)) {
        cells.push_back(pack(span.restore(ranked.key(i))));
        counts.push_back(0);
      }
      ++counts.back();
      cell_of[ranked.row(i)] = static_cast<int64_t>(cells.size()) - 1;
    }
  }
  return nb::make_tuple(give(std::move(cells)), give(std::move(counts)),
                        give(std::move(cell_of), {static_cast<size_t>(count)}));
}

const int64_t* check_rows(const Input& array, const char* name, int64_t end) {
  const int64_t* rows = check<int64_t>(array, name, {ANY});
  for (int64_t i = 0; i < rows_of(array); ++i)
    if (rows[i] < 0 || rows[i] >= end) refuse(std::string(name) + ": a row is out of range");
  return rows;
}

Output<int64_t> sum_neighbours(Integers cells, Integers values, Integers wanted) {
  const int64_t* keys = check_keys(cells, "cells");
  const int64_t count = rows_of(cells);
  const int64_t* value = check<int64_t>(values, "values", {count, ANY});
  const int64_t* rows = check_rows(wanted, "wanted", count);
  const int64_t width = static_cast<int64_t>(values.shape(1)), asked = rows_of(wanted);
  Buffer<int64_t> sums;
  {
    nb::gil_scoped_release unlocked;
    sums = make_buffer<int64_t>(asked * width);
    std::fill(sums.get(), sums.get() + asked * width, 0);
    Neighbourhood around(keys, count);
    for (int64_t i = 0; i < asked; ++i) {
      const int found = around.gather(keys[rows[i]]);
      for (int cell = 0; cell < found; ++cell)
        for (int64_t column = 0; column < width; ++column)
          // Unsigned, so that absurd values wrap as they do in numpy.
          sums[i * width + column] = static_cast<int64_t>(
              static_cast<uint64_t>(sums[i * width + column]) +
              static_cast<uint64_t>(value[around.rows[cell] * width + column]));
    }
  }
  return give(std::move(sums), {static_cast<size_t>(asked), static_cast<size_t>(width)});
}

enum Verdict : uint8_t { FINE = 0, UNSURE = 1, WRONG = 2 };

constexpr double ALIKE = 0.5;     // cosine from which normals agree; below its negative they oppose
constexpr int LEAST = 8;          // opponents that a verdict takes
constexpr int MAJORITY = 4;       // and as many more for each neighbour that agrees

// A cloud, and the rows of the points in each cell. Normals come as float where they lie so on disk:
// to widen them first would touch three times the memory.
template <class Normal>
struct CellPoints {
  const double* position;
  const Normal* normal;
  const int64_t* keys;
  int64_t cells;
  Large<int64_t> offsets;
  Large<uint32_t> row;
  double reach, tolerance, drift;
};

template <class A, class B>
inline double dot(const A* a, const B* b) {
  double products[3];
  for (int axis = 0; axis < 3; ++axis) products[axis] = static_cast<double>(a[axis]) * static_cast<double>(b[axis]);
  return products[0] + products[1] + products[2];
}

// The sum of the normals around a cell, and how many they are.
struct Around {
  double sum[3];
  int64_t count;
};

template <class Normal>
Large<Around> sum_normals(const Normal* normal, const int64_t* cell_of, int64_t points, const int64_t* keys,
                          int64_t cells, int threads) {
  Large<Around> own(static_cast<size_t>(cells), Around{}), all(own.size());
  for (int64_t i = 0; i < points; ++i) {
    Around& cell = own[cell_of[i]];
    for (int axis = 0; axis < 3; ++axis) cell.sum[axis] += static_cast<double>(normal[3 * i + axis]);
    ++cell.count;
  }
  run_ranges(cells, threads, [&](int64_t start, int64_t stop) {
    Neighbourhood around(keys, cells);
    for (int64_t c = start; c < stop; ++c) {
      Around total{};
      const int found = around.gather(keys[c]);
      for (int i = 0; i < found; ++i) {
        const Around& cell = own[around.rows[i]];
        for (int axis = 0; axis < 3; ++axis) total.sum[axis] += cell.sum[axis];
        total.count += cell.count;
      }
      all[c] = total;
    }
  });
  return all;
}

// Mark the points whose normals are at odds with the mean around their cells; return whether there are any.
template <class Normal>
bool mark_suspects(const Normal* normal, const int64_t* cell_of, int64_t points, const Large<Around>& around,
                   const uint8_t* asked, uint8_t* verdicts) {
  bool any = false;
  for (int64_t i = 0; i < points; ++i) {
    const Around& mean = around[cell_of[i]];
    const bool odd = asked[i] && !(dot(normal + 3 * i, mean.sum) > ALIKE * static_cast<double>(mean.count));
    verdicts[i] = odd ? UNSURE : FINE;
    any = any || odd;
  }
  return any;
}

template <class Normal>
void sort_rows(const int64_t* cell_of, int64_t points, CellPoints<Normal>& sorted) {
  sorted.offsets.assign(static_cast<size_t>(sorted.cells) + 1, 0);
  for (int64_t i = 0; i < points; ++i) ++sorted.offsets[cell_of[i] + 1];
  for (int64_t c = 0; c < sorted.cells; ++c) sorted.offsets[c + 1] += sorted.offsets[c];
  Large<int64_t> next(sorted.offsets.begin(), sorted.offsets.end() - 1);
  sorted.row.resize(static_cast<size_t>(points));
  for (int64_t i = 0; i < points; ++i) sorted.row[next[cell_of[i]]++] = static_cast<uint32_t>(i);
}

// Ask the points of the neighbourhood that lie on the sheet of point `row` for their normals.
template <class Normal>
Verdict poll(const CellPoints<Normal>& sorted, const Neighbourhood& around, int found, int64_t row) {
  const double* position = sorted.position + 3 * row;
  const Normal* normal = sorted.normal + 3 * row;
  int agree = 0, oppose = 0;
  double offsets = 0.0;
  for (int cell = 0; cell < found; ++cell)
    for (int64_t i = sorted.offsets[around.rows[cell]]; i < sorted.offsets[around.rows[cell] + 1]; ++i) {
      const int64_t at = 3 * static_cast<int64_t>(sorted.row[i]);
      const double* other = sorted.position + at;
      const double away[3] = {other[0] - position[0], other[1] - position[1], other[2] - position[2]};
      const double offset = dot(normal, away);
      if (std::abs(offset) > sorted.tolerance) continue;
      if (dot(away, away) > sorted.reach * sorted.reach) continue;
      if (std::abs(dot(sorted.normal + at, away)) > sorted.tolerance) continue;
      const double cosine = dot(normal, sorted.normal + at);
      agree += cosine > ALIKE;
      if (cosine < -ALIKE) ++oppose, offsets += offset;
    }
  --agree;  // the point itself
  if (oppose >= LEAST + MAJORITY * agree && std::abs(offsets) <= sorted.drift * oppose) return WRONG;
  return oppose > agree || agree + oppose < LEAST ? UNSURE : FINE;
}

// Judge the marked points of some cells.
template <class Normal>
void judge_cells(const CellPoints<Normal>& sorted, int64_t start, int64_t stop, uint8_t* verdicts) {
  Neighbourhood around(sorted.keys, sorted.cells);
  for (int64_t cell = start; cell < stop; ++cell) {
    int found = 0;
    for (int64_t at = sorted.offsets[cell]; at < sorted.offsets[cell + 1]; ++at) {
      const int64_t row = sorted.row[at];
      if (verdicts[row] == FINE) continue;
      if (!found) found = around.gather(sorted.keys[cell]);
      verdicts[row] = poll(sorted, around, found, row);
    }
  }
}

template <class Normal>
Output<uint8_t> poll_all(Input positions, Input normals, Input cells, Input cell_of, Input asked_of,
                         double reach, double tolerance, double drift, int64_t threads) {
  const double* position = check<double>(positions, "positions", {ANY, 3});
  const int64_t points = rows_of(positions);
  const Normal* normal = check<Normal>(normals, "normals", {points, 3});
  const int64_t* keys = check_keys(cells, "cells");
  const int64_t count = rows_of(cells);
  const int64_t* cell = check_rows(cell_of, "cell_of", count);
  if (rows_of(cell_of) != points) refuse("cell_of: expected another shape");
  const uint8_t* asked = check<uint8_t>(asked_of, "asked", {points});
  check_positive(reach, "reach");
  check_positive(tolerance, "tolerance");
  check_positive(drift, "drift");
  const int workers = check_threads(threads);
  Buffer<uint8_t> verdicts;
  {
    nb::gil_scoped_release unlocked;
    verdicts = make_buffer<uint8_t>(points);
    const Large<Around> around = sum_normals(normal, cell, points, keys, count, workers);
    if (mark_suspects(normal, cell, points, around, asked, verdicts.get())) {
      CellPoints<Normal> sorted{position, normal, keys, count, {}, {}, reach, tolerance, drift};
      sort_rows(cell, points, sorted);
      run_ranges(count, workers,
                 [&](int64_t start, int64_t stop) { judge_cells(sorted, start, stop, verdicts.get()); });
    }
  }
  return give(std::move(verdicts), {static_cast<size_t>(points)});
}

Output<uint8_t> poll_normals(Doubles positions, Contiguous normals, Integers cells, Integers cell_of, Input asked_of,
                             double reach, double tolerance, double drift, int64_t threads) {
  const auto run = normals.dtype() == nb::dtype<float>() ? &poll_all<float> : &poll_all<double>;
  return run(positions, normals, cells, cell_of, asked_of, reach, tolerance, drift, threads);
}

}  // namespace

void bind_outliers(nb::module_& module) {
  module.def("count_cells", &count_cells, "positions"_a, "low"_a, "edge"_a);
  module.def("sum_neighbours", &sum_neighbours, "keys"_a, "values"_a, "wanted"_a);
  module.def("poll_normals", &poll_normals, "positions"_a, "normals"_a, "keys"_a, "cell_of"_a, "asked"_a, "reach"_a,
             "tolerance"_a, "drift"_a, "threads"_a = 1);
}

}  // namespace hpc
