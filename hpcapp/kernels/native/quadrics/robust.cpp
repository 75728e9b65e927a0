// How far points lie from the blend of a level's quadrics (see robust.py).
#include <cmath>

#include "arrays.h"
#include "clones.h"
#include "constants.h"
#include "lattice/keys.h"
#include "moments.h"

namespace hpc {
namespace {

using namespace constants::robust;

// The quadrics at the eight corners of a cell, x fastest: one lane each.
struct Corners {
  double c[BASIS][LANES], variance[LANES];
};

struct Rated {
  const double* local;
  const int64_t *offsets, *cells, *keys;
  const float *coefficients, *variances;
  int64_t count;
  int depth;
  double* squares;
};

HPC_INLINE double rate_point(const Corners& corners, const double (&t)[3]) {
  double smooth[3], u[3][LANES], share[LANES], value[LANES], slope[3][LANES];
  for (int axis = 0; axis < 3; ++axis) smooth[axis] = t[axis] * t[axis] * (3.0 - 2.0 * t[axis]);
  for (int lane = 0; lane < LANES; ++lane) {
    share[lane] = 1.0;
    for (int axis = 0; axis < 3; ++axis) {
      const int bit = lane >> axis & 1;
      share[lane] *= bit ? smooth[axis] : 1.0 - smooth[axis];
      u[axis][lane] = t[axis] - bit;
    }
  }
  const auto& c = corners.c;
  EACH_LANE {
    const double x = u[0][lane], y = u[1][lane], z = u[2][lane];
    slope[0][lane] = c[1][lane] + 2.0 * c[4][lane] * x + c[7][lane] * y + c[9][lane] * z;
    slope[1][lane] = c[2][lane] + 2.0 * c[5][lane] * y + c[7][lane] * x + c[8][lane] * z;
    slope[2][lane] = c[3][lane] + 2.0 * c[6][lane] * z + c[8][lane] * y + c[9][lane] * x;
    const double linear = c[1][lane] * x + c[2][lane] * y + c[3][lane] * z;
    value[lane] = c[0][lane] + 0.5 * (linear + slope[0][lane] * x + slope[1][lane] * y + slope[2][lane] * z);
  }
  double f = 0.0, variance = 0.0, g[3] = {0.0, 0.0, 0.0};
  for (int lane = 0; lane < LANES; ++lane) {
    f += share[lane] * value[lane];
    variance += share[lane] * corners.variance[lane];
    for (int axis = 0; axis < 3; ++axis) g[axis] += share[lane] * slope[axis][lane];
  }
  const double squared = g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
  const double steep = squared > LEAST_SLOPE ? squared : LEAST_SLOPE;
  return f * f / (steep * (variance > LEAST_VARIANCE ? variance : LEAST_VARIANCE));
}

HPC_CLONES void rate_cell(const Rated& all, const Corners& corners, int64_t cell, const double (&low)[3]) {
  const double scale = 1.0 / (1 << all.depth);
  for (int64_t i = all.offsets[cell]; i < all.offsets[cell + 1]; ++i) {
    double t[3];
    for (int axis = 0; axis < 3; ++axis) t[axis] = (low[axis] + all.local[3 * i + axis] + 0.5) * scale;
    all.squares[i] = rate_point(corners, t);
  }
}

void rate_range(const Rated& all, int64_t start, int64_t stop) {
  std::vector<Finger> fingers(LANES, Finger(all.keys, all.count));
  Corners corners;
  for (int64_t cell = start; cell < stop; ++cell) {
    const Place place = unpack(all.cells[cell]);
    Place above;
    double low[3];
    for (int axis = 0; axis < 3; ++axis) {
      above[axis] = place[axis] >> all.depth;
      low[axis] = static_cast<double>(place[axis] - above[axis] * (int64_t{1} << all.depth));
    }
    bool known = true;
    for (int lane = 0; lane < LANES && known; ++lane) {
      const int64_t row = fingers[lane].find(pack(above) + (lane & 1) * STRIDES[0] + (lane >> 1 & 1) * STRIDES[1] + (lane >> 2));
      known = row >= 0;
      if (!known) break;
      for (int i = 0; i < BASIS; ++i) corners.c[i][lane] = all.coefficients[row * BASIS + i];
      corners.variance[lane] = all.variances[row];
    }
    if (known) {
      rate_cell(all, corners, cell, low);
    } else {
      std::fill(all.squares + all.offsets[cell], all.squares + all.offsets[cell + 1], 0.0);
    }
  }
}

Output<double> rate_points(Input local_of, Input offsets_of, Input cells_of, int64_t depth, Input corners_of,
                           Input coefficients_of, Input variances_of) {
  const double* local = check<double>(local_of, "local_positions", {ANY, 3});
  const int64_t* cells = check_keys(cells_of, "cells");
  const int64_t* corners = check_keys(corners_of, "corners");
  const int64_t points = rows_of(local_of), count = rows_of(cells_of), known = rows_of(corners_of);
  const int64_t* offsets = check_offsets(offsets_of, count, points);
  if (depth < 0 || depth > 20) refuse("depth: expected 0 to 20");
  auto squares = make_buffer<double>(points);
  const Rated all{local, offsets, cells, corners, check<float>(coefficients_of, "coefficients", {known, BASIS}),
                  check<float>(variances_of, "variances", {known}), known, static_cast<int>(depth), squares.get()};
  {
    const Unlocked unlocked;
    rate_range(all, 0, count);
  }
  return give(std::move(squares), {static_cast<size_t>(points)});
}

}  // namespace

HPC_KERNELS {
  module.def("rate_points", &rate_points, "local"_a, "offsets"_a, "cells"_a, "depth"_a, "corners"_a, "coefficients"_a,
             "variances"_a);
}

}  // namespace hpc
