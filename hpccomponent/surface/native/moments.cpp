// Moments of points: sums over the points of a cell, moved and merged into parents.
#include "moments.h"

#include "families.h"
#include "keys.h"
#include "threads.h"

namespace hpc {
namespace {

// Each monomial is the product of an earlier one and one coordinate.
struct Products {
  int source[MONOMIALS], axis[MONOMIALS];
  constexpr Products() : source(), axis() {
    for (int column = 1; column < MONOMIALS; ++column) {
      int first = 0;
      while (!EXPONENTS[column].power[first]) ++first;
      axis[column] = first;
      source[column] = lowered(column, first, 1);
    }
  }
};

constexpr Products PRODUCTS;

HPC_INLINE void write_monomials(const double* u, const double* n, double* m) {
  m[0] = 1.0;
  for (int column = 1; column < MONOMIALS; ++column)
    m[column] = m[PRODUCTS.source[column]] * u[PRODUCTS.axis[column]];
  for (int axis = 0; axis < 3; ++axis) {
    m[35 + axis] = n[axis];
    m[38 + axis] = 2.0 * u[axis] * n[axis];
  }
  m[41] = u[1] * n[0] + u[0] * n[1];
  m[42] = u[2] * n[1] + u[1] * n[2];
  m[43] = u[2] * n[0] + u[0] * n[2];
}

HPC_CLONES void sum_cells(const double* local, const double* normals, const int64_t* offsets,
                          int64_t start, int64_t stop, double* moments) {
  for (int64_t cell = start; cell < stop; ++cell) {
    double sums[COLUMNS] = {0.0}, terms[COLUMNS];
    for (int64_t i = offsets[cell]; i < offsets[cell + 1]; ++i) {
      write_monomials(local + 3 * i, normals + 3 * i, terms);
      for (int column = 0; column < COLUMNS; ++column) sums[column] += terms[column];
    }
    for (int column = 0; column < COLUMNS; ++column) moments[cell * COLUMNS + column] = sums[column];
  }
}

Output<double> accumulate_moments(Input local_of, Input normals_of, Input offsets_of, int64_t threads) {
  const double* local = check<double>(local_of, "local_positions", {ANY, 3});
  const int64_t points = rows_of(local_of);
  const double* normals = check<double>(normals_of, "normals", {points, 3});
  const int64_t* offsets = check<int64_t>(offsets_of, "offsets", {ANY});
  const int64_t cells = rows_of(offsets_of) - 1;
  const int workers = check_threads(threads);
  if (cells < 0 || offsets[0] != 0 || offsets[cells] != points)
    refuse("offsets: expected to run from 0 to the number of points");
  for (int64_t cell = 0; cell < cells; ++cell)
    if (offsets[cell] > offsets[cell + 1]) refuse("offsets: expected to rise");
  auto moments = make_buffer<double>(cells * COLUMNS);
  {
    nb::gil_scoped_release unlocked;
    run_ranges(cells, workers, [&](int64_t start, int64_t stop) {
      sum_cells(local, normals, offsets, start, stop, moments.get());
    });
  }
  return give(std::move(moments), {static_cast<size_t>(cells), COLUMNS});
}

HPC_CLONES void shift_rows(const double* from, int64_t count, const double* step, double* to) {
  Block block;
  double steps[3][LANES];
  for (int axis = 0; axis < 3; ++axis)
    for (int lane = 0; lane < LANES; ++lane) steps[axis][lane] = step[axis];
  for (int64_t start = 0; start < count; start += LANES) {
    const int width = static_cast<int>(std::min<int64_t>(LANES, count - start));
    for (int lane = 0; lane < LANES; ++lane)
      for (int column = 0; column < COLUMNS; ++column)
        block[column][lane] = lane < width ? from[(start + lane) * COLUMNS + column] : 0.0;
    shift_block(block, steps);
    for (int lane = 0; lane < width; ++lane)
      for (int column = 0; column < COLUMNS; ++column)
        to[(start + lane) * COLUMNS + column] = block[column][lane];
  }
}

Output<double> shift_moments(Input moments_of, Input shift_of) {
  const double* moments = check<double>(moments_of, "moments", {ANY, COLUMNS});
  const double* shift = check<double>(shift_of, "shift", {3});
  const int64_t count = rows_of(moments_of);
  auto shifted = make_buffer<double>(count * COLUMNS);
  {
    nb::gil_scoped_release unlocked;
    shift_rows(moments, count, shift, shifted.get());
  }
  return give(std::move(shifted), {static_cast<size_t>(count), COLUMNS});
}

// Add rows to their parents', child after child; `order` holds key * 8 + octant.
HPC_CLONES void merge_rows(const double* moments, const Ranked* order, int64_t count,
                           const int32_t* owners, double* merged) {
  Block block;
  double steps[3][LANES];
  for (int64_t start = 0; start < count; start += LANES) {
    const int width = static_cast<int>(std::min<int64_t>(LANES, count - start));
    for (int lane = 0; lane < LANES; ++lane) {
      const Ranked child = order[start + std::min(lane, width - 1)];
      for (int axis = 0; axis < 3; ++axis) steps[axis][lane] = (child.key >> axis & 1) ? 0.5 : -0.5;
      for (int column = 0; column < COLUMNS; ++column)
        block[column][lane] = moments[child.row * static_cast<int64_t>(COLUMNS) + column];
    }
    shift_block(block, steps);
    for (int lane = 0; lane < width; ++lane) {
      double* row = merged + owners[start + lane] * static_cast<int64_t>(COLUMNS);
      for (int column = 0; column < COLUMNS; ++column) row[column] += block[column][lane];
    }
  }
}

// Express rows in cells of twice the size; powers of two are exact.
HPC_CLONES void scale_rows(double* rows, int64_t count) {
  double factors[COLUMNS];
  for (int column = 0; column < COLUMNS; ++column) {
    int degree = column < 38 ? 0 : 1;
    if (column < MONOMIALS)
      degree = EXPONENTS[column].power[0] + EXPONENTS[column].power[1] + EXPONENTS[column].power[2];
    factors[column] = 1.0 / (1 << degree);
  }
  for (int64_t row = 0; row < count; ++row)
    for (int column = 0; column < COLUMNS; ++column) rows[row * COLUMNS + column] *= factors[column];
}

Output<double> scale_moments(Input moments_of) {
  const double* moments = check<double>(moments_of, "moments", {ANY, COLUMNS});
  const int64_t count = rows_of(moments_of);
  auto scaled = make_buffer<double>(count * COLUMNS);
  std::copy(moments, moments + count * COLUMNS, scaled.get());
  scale_rows(scaled.get(), count);
  return give(std::move(scaled), {static_cast<size_t>(count), COLUMNS});
}

// Rank cells by parent, then by octant.
std::vector<Ranked> rank_children(const int64_t* cells, int64_t count, Span& span) {
  Place low{BIAS, BIAS, BIAS}, high{-BIAS, -BIAS, -BIAS};
  for (int64_t i = 0; i < count; ++i) {
    const Place place = unpack(cells[i]);
    for (int axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], place[axis] >> 1);
      high[axis] = std::max(high[axis], place[axis] >> 1);
    }
  }
  span = Span(low, high);
  std::vector<Ranked> order(static_cast<size_t>(count));
  for (int64_t i = 0; i < count; ++i) {
    const Place p = unpack(cells[i]);
    const uint64_t octant = (p[0] & 1) | (p[1] & 1) << 1 | (p[2] & 1) << 2;
    order[i] = {span.squeeze({p[0] >> 1, p[1] >> 1, p[2] >> 1}) << 3 | octant, static_cast<uint32_t>(i)};
  }
  radix_sort(order, span.bits() + 3);
  return order;
}

nb::tuple merge_cells(Input cells_of, Input moments_of) {
  const int64_t* cells = check_keys(cells_of, "cells");
  const int64_t count = rows_of(cells_of);
  const double* moments = check<double>(moments_of, "moments", {count, COLUMNS});
  std::vector<int64_t> parents;
  Buffer<double> merged;
  if (count) {
    nb::gil_scoped_release unlocked;
    Span span({0, 0, 0}, {0, 0, 0});
    const std::vector<Ranked> order = rank_children(cells, count, span);
    std::vector<int32_t> owners(static_cast<size_t>(count));
    for (int64_t i = 0; i < count; ++i) {
      if (!i || order[i].key >> 3 != order[i - 1].key >> 3)
        parents.push_back(pack(span.restore(order[i].key >> 3)));
      owners[i] = static_cast<int32_t>(parents.size() - 1);
    }
    const int64_t size = static_cast<int64_t>(parents.size());
    merged = make_buffer<double>(size * COLUMNS);
    std::fill(merged.get(), merged.get() + size * COLUMNS, 0.0);
    merge_rows(moments, order.data(), count, owners.data(), merged.get());
    scale_rows(merged.get(), size);
  } else {
    merged = make_buffer<double>(0);
  }
  const size_t size = parents.size();
  return nb::make_tuple(give(std::move(parents)), give(std::move(merged), {size, COLUMNS}));
}

}  // namespace

void bind_moments(nb::module_& module) {
  module.def("accumulate_moments", &accumulate_moments);
  module.def("shift_moments", &shift_moments);
  module.def("scale_moments", &scale_moments);
  module.def("merge_cells", &merge_cells);
}

}  // namespace hpc
