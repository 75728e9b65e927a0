// The poll that tells wrong normals (see normals.py).
#include "arrays.h"
#include "constants.h"
#include "lattice/keys.h"
#include "threads.h"

namespace hpc {
namespace {

using namespace constants::normals;
using constants::FINE, constants::UNSURE, constants::WRONG;

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
uint8_t poll(const CellPoints<Normal>& sorted, const Neighbourhood& around, int found, int64_t row) {
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
    const Unlocked unlocked;
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

HPC_KERNELS {
  module.def("poll_normals", &poll_normals, "positions"_a, "normals"_a, "keys"_a, "cell_of"_a, "asked"_a, "reach"_a,
             "tolerance"_a, "drift"_a, "threads"_a = 1);
}

}  // namespace hpc
