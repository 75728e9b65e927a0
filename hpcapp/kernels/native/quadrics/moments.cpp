// Moments of points: sums over the points of a cell, moved and merged into parents.
#include "moments.h"

#include <nanobind/stl/optional.h>

#include "arrays.h"
#include "lattice/keys.h"
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

// One point of each lane's cell; lanes whose cell has no more points hold zeros.
struct Points {
  double one[LANES], u[3][LANES], n[3][LANES];
};

template <int COLUMN>
HPC_INLINE void add_monomial(const Points& p, double (&m)[MONOMIALS][LANES], Block& sums) {
  const double *source = m[PRODUCTS.source[COLUMN]], *along = p.u[PRODUCTS.axis[COLUMN]];
  EACH_LANE m[COLUMN][lane] = source[lane] * along[lane];
  EACH_LANE sums[COLUMN][lane] += m[COLUMN][lane];
}

template <int... BEFORE>
HPC_INLINE void add_monomials(const Points& p, Block& sums, std::integer_sequence<int, BEFORE...>) {
  double m[MONOMIALS][LANES];
  EACH_LANE m[0][lane] = p.one[lane];
  EACH_LANE sums[0][lane] += m[0][lane];
  (add_monomial<BEFORE + 1>(p, m, sums), ...);
}

HPC_INLINE void add_points(const Points& p, Block& sums) {
  add_monomials(p, sums, std::make_integer_sequence<int, MONOMIALS - 1>());
  for (int a = 0; a < 3; ++a) {
    // xx, yy, zz follow from one axis; xy, yz, zx from two neighbouring ones.
    const int b = (a + 1) % 3;
    EACH_LANE sums[35 + a][lane] += p.n[a][lane];
    EACH_LANE sums[38 + a][lane] += 2.0 * p.u[a][lane] * p.n[a][lane];
    EACH_LANE sums[41 + a][lane] += p.u[b][lane] * p.n[a][lane] + p.u[a][lane] * p.n[b][lane];
  }
}

// Each lane sums the points of one cell, in their order; without weights each counts 1.
HPC_CLONES void sum_cells(const double* local, const double* normals, const double* weights, const int64_t* offsets,
                          int64_t start, int64_t stop, double* moments) {
  for (; start < stop; start += LANES) {
    const int width = static_cast<int>(std::min<int64_t>(LANES, stop - start));
    int64_t longest = 0;
    for (int lane = 0; lane < width; ++lane)
      longest = std::max(longest, offsets[start + lane + 1] - offsets[start + lane]);
    Block sums = {};
    Points points = {};
    for (int64_t turn = 0; turn < longest; ++turn) {
      for (int lane = 0; lane < width; ++lane) {
        const int64_t i = offsets[start + lane] + turn;
        const bool present = i < offsets[start + lane + 1];
        const double weight = present ? weights ? weights[i] : 1.0 : 0.0;
        points.one[lane] = weight;
        for (int axis = 0; axis < 3; ++axis) {
          points.u[axis][lane] = present ? local[3 * i + axis] : 0.0;
          points.n[axis][lane] = present ? weight * normals[3 * i + axis] : 0.0;
        }
      }
      add_points(points, sums);
    }
    for (int lane = 0; lane < width; ++lane)
      for (int column = 0; column < COLUMNS; ++column)
        moments[(start + lane) * COLUMNS + column] = sums[column][lane];
  }
}

Output<double> accumulate_moments(Doubles local_of, Doubles normals_of, Integers offsets_of,
                                  std::optional<Doubles> weights_of, int64_t threads) {
  const double* local = check<double>(local_of, "local_positions", {ANY, 3});
  const int64_t points = rows_of(local_of);
  const double* normals = check<double>(normals_of, "normals", {points, 3});
  const int64_t* offsets = check_offsets(offsets_of, ANY, points);
  const double* weights = weights_of ? check<double>(*weights_of, "weights", {points}) : nullptr;
  const int64_t cells = rows_of(offsets_of) - 1;
  const int workers = check_threads(threads);
  auto moments = make_buffer<double>(cells * COLUMNS);
  {
    const Unlocked unlocked;
    run_ranges(cells, workers, [&](int64_t start, int64_t stop) {
      sum_cells(local, normals, weights, offsets, start, stop, moments.get());
    });
  }
  return give(std::move(moments), {static_cast<size_t>(cells), COLUMNS});
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

// Rank cells by parent, then by octant.
Ranking rank_children(const int64_t* cells, int64_t count, Span& span) {
  if (!count) return Ranking(0, 0);
  Place low{BIAS, BIAS, BIAS}, high{-BIAS, -BIAS, -BIAS};
  for (int64_t i = 0; i < count; ++i) {
    const Place place = unpack(cells[i]);
    for (int axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], place[axis] >> 1);
      high[axis] = std::max(high[axis], place[axis] >> 1);
    }
  }
  span = Span(low, high);
  Ranking order(count, span.bits() + 3);
  for (int64_t i = 0; i < count; ++i) {
    const Place p = unpack(cells[i]);
    const uint64_t octant = (p[0] & 1) | (p[1] & 1) << 1 | (p[2] & 1) << 2;
    order.add(i, span.squeeze({p[0] >> 1, p[1] >> 1, p[2] >> 1}) << 3 | octant);
  }
  order.sort();
  return order;
}

// The children of each parent, octants with x fastest; -1 where there is none.
struct Family {
  int64_t key;
  int64_t children[8];
};

Large<Family> group_children(const int64_t* cells, int64_t count) {
  Span span({0, 0, 0}, {0, 0, 0});
  const Ranking order = rank_children(cells, count, span);
  Large<Family> families;
  families.reserve(static_cast<size_t>(count / 2));
  uint64_t last = 0;
  for (int64_t i = 0; i < count; ++i) {
    const uint64_t key = order.key(i) >> 3;
    if (!i || key != last) families.push_back({pack(span.restore(key)), {-1, -1, -1, -1, -1, -1, -1, -1}});
    last = key;
    families.back().children[order.key(i) & 7] = order.row(i);
  }
  return families;
}

// Sum each family: pairs along z, then y, then x.
HPC_CLONES void merge_rows(const double* moments, const Family* families, int64_t count, double* merged) {
  Block low, high, rows[2], planes[2], total;
  int64_t around[8][LANES];
  for (int64_t start = 0; start < count; start += LANES) {
    const int width = static_cast<int>(std::min<int64_t>(LANES, count - start));
    for (int octant = 0; octant < 8; ++octant)
      for (int lane = 0; lane < LANES; ++lane)
        around[octant][lane] = lane < width ? families[start + lane].children[octant] : -1;
    for (int x = 0; x < 2; ++x) {
      for (int y = 0; y < 2; ++y) {
        load_rows(moments, around[x + 2 * y], low);
        load_rows(moments, around[x + 2 * y + 4], high);
        sum_pair<2>(low, high, rows[y]);
      }
      sum_pair<1>(rows[0], rows[1], planes[x]);
    }
    sum_pair<0>(planes[0], planes[1], total);
    for (int lane = 0; lane < width; ++lane)
      for (int column = 0; column < COLUMNS; ++column)
        merged[(start + lane) * COLUMNS + column] = total[column][lane];
  }
}

nb::tuple merge_cells(Integers cells_of, Doubles moments_of) {
  const int64_t* cells = check_keys(cells_of, "cells");
  const int64_t count = rows_of(cells_of);
  const double* moments = check<double>(moments_of, "moments", {count, COLUMNS});
  Large<int64_t> parents;
  Buffer<double> merged;
  {
    const Unlocked unlocked;
    const Large<Family> families = group_children(cells, count);
    const int64_t size = static_cast<int64_t>(families.size());
    for (const Family& family : families) parents.push_back(family.key);
    merged = make_buffer<double>(size * COLUMNS);
    merge_rows(moments, families.data(), size, merged.get());
    scale_rows(merged.get(), size);
  }
  const size_t size = parents.size();
  return nb::make_tuple(give(std::move(parents)), give(std::move(merged), {size, COLUMNS}));
}

}  // namespace

HPC_KERNELS {
  module.def("accumulate_moments", &accumulate_moments, "local_positions"_a, "normals"_a, "offsets"_a,
             "weights"_a.none() = nb::none(), "threads"_a = 1);
  module.def("merge_cells", &merge_cells, "cells"_a, "moments"_a);
}

}  // namespace hpc
