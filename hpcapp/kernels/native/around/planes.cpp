// Planes through as many neighbours of each point as noise and curvature allow (see around/planes.py).
#include <algorithm>
#include <cmath>
#include <iterator>

#include "arrays.h"
#include "clones.h"
#include "constants.h"
#include "nearest.h"
#include "threads.h"

namespace hpc {
namespace {

using namespace constants::planes;

constexpr int FITS = std::size(COUNTS), MORE_FITS = std::size(MORE_COUNTS);
constexpr int LANES = FITS + MORE_FITS - 1;  // planes of a point: one is both the last and the first of more
static_assert(COUNTS[FITS - 1] == MORE_COUNTS[0] && LANES == 8);

enum Product { XX, YY, ZZ, XY, XZ, YZ, PRODUCTS };  // in the order of `PAIRS`

// Planes through several neighbourhoods of a point, in units.
struct Planes {
  double held[LANES], squares[LANES], extent[LANES], least[LANES], spread[PRODUCTS][LANES];
};

// Sums over the neighbours in each neighbourhood: of coordinates, and of their products.
struct Sums {
  double mean[3][LANES], product[PRODUCTS][LANES];
};

HPC_CLONES void add_up(const Neighbours& near, const int* ends, int count, Sums& sums) {
  double x = 0.0, y = 0.0, z = 0.0, xx = 0.0, yy = 0.0, zz = 0.0, xy = 0.0, xz = 0.0, yz = 0.0;
  int i = 0;
  for (int fit = 0; fit < count; ++fit) {
    for (; i < ends[fit]; ++i) {
      const double ax = near.x[i], ay = near.y[i], az = near.z[i];
      x += ax, y += ay, z += az;
      xx += ax * ax, yy += ay * ay, zz += az * az;
      xy += ax * ay, xz += ax * az, yz += ay * az;
    }
    sums.mean[0][fit] = x, sums.mean[1][fit] = y, sums.mean[2][fit] = z;
    sums.product[XX][fit] = xx, sums.product[YY][fit] = yy, sums.product[ZZ][fit] = zz;
    sums.product[XY][fit] = xy, sums.product[XZ][fit] = xz, sums.product[YZ][fit] = yz;
  }
}

// Two planes through the neighbours of a point, of which the normal is that of the nearer one.
struct Sheets {
  bool are_told = false;
  double normal[3], square;
};

// Find the least eigenvalues of the covariances: see _least_eigenvalues.
HPC_CLONES void solve_planes(Sums& sums, Planes& planes) {
  double trace[LANES], minors[LANES], determinant[LANES], root[LANES] = {};
  const double* held = planes.held;
  HPC_LANES
  for (int lane = 0; lane < LANES; ++lane) {
    const double x = sums.mean[0][lane] / held[lane], y = sums.mean[1][lane] / held[lane];
    const double z = sums.mean[2][lane] / held[lane];
    const double xx = sums.product[XX][lane] / held[lane] - x * x, yy = sums.product[YY][lane] / held[lane] - y * y;
    const double zz = sums.product[ZZ][lane] / held[lane] - z * z, xy = sums.product[XY][lane] / held[lane] - x * y;
    const double xz = sums.product[XZ][lane] / held[lane] - x * z, yz = sums.product[YZ][lane] / held[lane] - y * z;
    planes.spread[XX][lane] = xx, planes.spread[YY][lane] = yy, planes.spread[ZZ][lane] = zz;
    planes.spread[XY][lane] = xy, planes.spread[XZ][lane] = xz, planes.spread[YZ][lane] = yz;
    trace[lane] = xx + yy + zz;
    minors[lane] = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz;
    determinant[lane] = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
  }
  for (int step = 0; step < STEPS; ++step) {
    int64_t moved[LANES];
    HPC_LANES
    for (int lane = 0; lane < LANES; ++lane) {
      const double at = root[lane];
      const double value = ((at - trace[lane]) * at + minors[lane]) * at - determinant[lane];
      const double slope = (3.0 * at - 2.0 * trace[lane]) * at + minors[lane];
      const bool falling = (value < 0.0) & (slope > 0.0);
      const double next = at + (falling ? -value / (falling ? slope : 1.0) : 0.0);
      moved[lane] = next != at;
      root[lane] = next;
    }
    int64_t any = 0;
    for (int lane = 0; lane < LANES; ++lane) any |= moved[lane];
    if (!any) break;
  }
  HPC_LANES
  for (int lane = 0; lane < LANES; ++lane) {
    const double third = trace[lane] / 3.0, least = root[lane] < third ? root[lane] : third;
    const double freedom = held[lane] - 3.0;
    planes.least[lane] = least;
    planes.squares[lane] = least * (held[lane] / (freedom > 1.0 ? freedom : 1.0));
    planes.extent[lane] = held[lane] < LEAST ? 0.0 : trace[lane] - least;
  }
}

// Fit the first planes, or all.
void fit(const Neighbours& near, int fits, Planes& planes, Sums& sums) {
  int ends[LANES];
  sums = Sums{};
  std::fill_n(planes.held, LANES, 1.0);
  for (int i = 0; i < fits; ++i) {
    ends[i] = near.count(i < FITS ? COUNTS[i] : MORE_COUNTS[i - FITS + 1]);
    planes.held[i] = std::max(ends[i], 1);
  }
  add_up(near, ends, fits, sums);
  solve_planes(sums, planes);
}

// Return which of some planes is expected to be the best.
int choose(const Planes& planes, int first, int count, double noise) {
  int best = first;
  double least = INFINITY;
  for (int i = first; i < first + count; ++i) {
    if (!(planes.extent[i] > 0.0)) continue;
    const double beyond = std::max(planes.squares[i] - noise, 0.0);
    const double error = (4.0 * noise / planes.held[i] + constants::planes::BIAS * beyond) / planes.extent[i];
    if (error < least) least = error, best = i;
  }
  return best;
}

// Find the least eigenvalue of one matrix: see _least_eigenvalues.
double find_least(const double (&spread)[PRODUCTS]) {
  const double xx = spread[XX], yy = spread[YY], zz = spread[ZZ], xy = spread[XY], xz = spread[XZ], yz = spread[YZ];
  const double trace = xx + yy + zz;
  const double minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz;
  const double determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
  double root = 0.0;
  for (int step = 0; step < STEPS; ++step) {
    const double value = ((root - trace) * root + minors) * root - determinant;
    const double slope = (3.0 * root - 2.0 * trace) * root + minors;
    if (!((value < 0.0) & (slope > 0.0))) break;
    root += -value / slope;
  }
  return std::min(root, trace / 3.0);
}

// Find the unit vector of the least eigenvalue: see _least_eigenvectors.
void find_normal(const double (&spread)[PRODUCTS], double least, double (&normal)[3]) {
  const double rows[3][3] = {{spread[XX] - least, spread[XY], spread[XZ]},
                             {spread[XY], spread[YY] - least, spread[YZ]},
                             {spread[XZ], spread[YZ], spread[ZZ] - least}};
  constexpr int PAIRS[3][2] = {{0, 1}, {0, 2}, {1, 2}};
  double longest[3] = {0.0, 0.0, 1.0}, most = 0.0;
  for (const auto& pair : PAIRS) {
    const auto &a = rows[pair[0]], &b = rows[pair[1]];
    const double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
    const double square = x * x + y * y + z * z;
    if (square > most) longest[0] = x, longest[1] = y, longest[2] = z, most = square;
  }
  const double length = std::sqrt(most > 0.0 ? most : 1.0);
  for (int axis = 0; axis < 3; ++axis) normal[axis] = longest[axis] / length;
}

// Find the normal of a plane.
void find_normal(const Planes& planes, int at, double (&normal)[3]) {
  double spread[PRODUCTS];
  for (int product = 0; product < PRODUCTS; ++product) spread[product] = planes.spread[product][at];
  find_normal(spread, planes.least[at], normal);
}

// The points that may lie on two sheets, and how far each is along a direction; no more of them than that.
constexpr int HEIGHTS = COUNTS[SHEET_COUNT];
static_assert(HEIGHTS % LANES == 0);

struct Heights {
  double each[HEIGHTS], rising[HEIGHTS];
};

// Measure points along a direction, and put them in order.
HPC_CLONES void measure_heights(const Neighbours& near, int count, const double* normal, Heights& heights) {
  const double *x = near.x, *y = near.y, *z = near.z;
  for (int i = 0; i < HEIGHTS; ++i) heights.each[i] = -INFINITY;
  HPC_LANES
  for (int i = 0; i < count; ++i) heights.each[i] = normal[0] * x[i] + normal[1] * y[i] + normal[2] * z[i];
  int64_t place[HEIGHTS];
  for (int start = 0; start < HEIGHTS; start += LANES) {
    int64_t lower[LANES] = {};
    for (int i = 0; i < count; ++i) {
      const double height = heights.each[i];
      HPC_LANES
      for (int lane = 0; lane < LANES; ++lane) {
        const double other = heights.each[start + lane];
        lower[lane] += (height < other) | ((height == other) & (i < start + lane));
      }
    }
    for (int lane = 0; lane < LANES; ++lane) place[start + lane] = lower[lane];
  }
  for (int i = 0; i < count; ++i) heights.rising[place[i]] = heights.each[i];
}

// Return below which of some heights two groups of them are told apart best.
double cut_heights(const double* heights, int count) {
  double total = 0.0, below = 0.0, most = -1.0, bound = 0.0;
  for (int i = 0; i < count; ++i) total += heights[i];
  for (int lower = 1; lower <= count - SHEET_LEAST; ++lower) {
    below += heights[lower - 1];
    if (lower < SHEET_LEAST) continue;
    const double above = total - below;
    const double between = below * below / lower + above * above / (count - lower);
    if (between > most) most = between, bound = heights[lower - 1];
  }
  return bound;
}

// Some neighbours: how many they are, and the sums of their coordinates and of the products of these.
struct Half {
  double held, sum[3], product[PRODUCTS];
};

// A plane through some neighbours, and their squares across it.
struct Side {
  double normal[3], offset, squares;
};

// Add up the points that are marked by 1, not 0.
HPC_CLONES void add_marked(const Neighbours& near, const double* marks, Half& half) {
  double sums[1 + 3 + PRODUCTS][LANES] = {};
  for (int start = 0; start < HEIGHTS; start += LANES)
    HPC_LANES
    for (int lane = 0; lane < LANES; ++lane) {
      const int i = start + lane;
      const bool is_marked = marks[i] != 0.0;
      const double x = is_marked ? near.x[i] : 0.0, y = is_marked ? near.y[i] : 0.0, z = is_marked ? near.z[i] : 0.0;
      sums[0][lane] += marks[i];
      sums[1][lane] += x, sums[2][lane] += y, sums[3][lane] += z;
      sums[4 + XX][lane] += x * x, sums[4 + YY][lane] += y * y, sums[4 + ZZ][lane] += z * z;
      sums[4 + XY][lane] += x * y, sums[4 + XZ][lane] += x * z, sums[4 + YZ][lane] += y * z;
    }
  half = Half{};
  for (int lane = 0; lane < LANES; ++lane) {
    half.held += sums[0][lane];
    for (int axis = 0; axis < 3; ++axis) half.sum[axis] += sums[1 + axis][lane];
    for (int product = 0; product < PRODUCTS; ++product) half.product[product] += sums[4 + product][lane];
  }
}

// Mark the points that are nearer to the second of two planes.
HPC_CLONES void mark_nearer(const Neighbours& near, int count, const Side (&sides)[2], double* marks) {
  const double *x = near.x, *y = near.y, *z = near.z;
  const double *a = sides[0].normal, *b = sides[1].normal;
  HPC_LANES
  for (int i = 0; i < count; ++i) {
    const double first = std::abs(a[0] * x[i] + a[1] * y[i] + a[2] * z[i] - sides[0].offset);
    const double second = std::abs(b[0] * x[i] + b[1] * y[i] + b[2] * z[i] - sides[1].offset);
    marks[i] = second < first ? 1.0 : 0.0;
  }
}

// Fit a plane: see _fit_side.
void fit_side(const Half& half, Side& side) {
  double mean[3], spread[PRODUCTS];
  for (int axis = 0; axis < 3; ++axis) mean[axis] = half.sum[axis] / half.held;
  for (int product = 0; product < PRODUCTS; ++product)
    spread[product] = half.product[product] / half.held - mean[PAIRS[product][0]] * mean[PAIRS[product][1]];
  const double least = find_least(spread);
  find_normal(spread, least, side.normal);
  side.offset = mean[0] * side.normal[0] + mean[1] * side.normal[1] + mean[2] * side.normal[2];
  side.squares = std::max(least, 0.0) * half.held;
}

// Fit two planes where one leaves much over, and these leave little.
Sheets find_sheets(const Neighbours& near, const Planes& planes, const Sums& sums) {
  Sheets sheets;
  const double alone = planes.squares[SHEET_COUNT];
  const int count = near.count(COUNTS[SHEET_COUNT]);
  if (count < 2 * SHEET_LEAST || !(alone > THICK * UNITS * (THICK * UNITS))) return sheets;
  double normal[3], marks[HEIGHTS] = {};
  find_normal(planes, SHEET_COUNT, normal);
  Heights heights;
  measure_heights(near, count, normal, heights);
  const double bound = cut_heights(heights.rising, count);
  for (int i = 0; i < count; ++i) marks[i] = heights.each[i] > bound ? 1.0 : 0.0;
  Side sides[2];
  for (int round = 0; round < SHEET_ROUNDS; ++round) {
    Half upper, lower;
    add_marked(near, marks, upper);
    lower.held = count - upper.held;
    for (int axis = 0; axis < 3; ++axis) lower.sum[axis] = sums.mean[axis][SHEET_COUNT] - upper.sum[axis];
    for (int product = 0; product < PRODUCTS; ++product)
      lower.product[product] = sums.product[product][SHEET_COUNT] - upper.product[product];
    if (std::min(lower.held, upper.held) < SHEET_LEAST) return sheets;
    fit_side(lower, sides[0]);
    fit_side(upper, sides[1]);
    mark_nearer(near, count, sides, marks);
  }
  sheets.square = (sides[0].squares + sides[1].squares) / (count - 6.0);
  sheets.are_told = sheets.square < APART * APART * alone;
  std::copy_n(sides[marks[0] != 0.0].normal, 3, sheets.normal);  // the first is the point itself
  return sheets;
}

// Write a normal, as long as its residual in length units of the input.
void write(const double (&normal)[3], double square, double unit, float* vector) {
  const double residual = std::max(std::sqrt(square), TINY * UNITS) * unit;
  for (int axis = 0; axis < 3; ++axis) vector[axis] = static_cast<float>(normal[axis] * residual);
}

// Write the normal of a plane.
void take(const Planes& planes, int at, double unit, float* vector) {
  double normal[3];
  find_normal(planes, at, normal);
  write(normal, planes.squares[at], unit, vector);
}

// Fits planes to the points of one cell after the other; each thread has its own.
class PlaneFitter {
 public:
  // The vector of each point goes to the place of its row; negative where none is wanted.
  PlaneFitter(const UnitPoints& points, const int64_t* place_of, double unit, float* vectors)
      : points_(points), place_of_(place_of), unit_(unit), vectors_(vectors),
        search_(points, COUNTS[FITS - 1], REACH), more_(points, MORE_COUNTS[MORE_FITS - 1], REACH) {}

  void fit_cell(int64_t cell) {
    const int64_t first = points_.offsets[cell];
    const int count = static_cast<int>(points_.offsets[cell + 1] - first);
    const auto place = [&](int i) { return place_of_[points_.rows[first + i]]; };
    bool any = false;
    wanted_.clear();
    for (int i = 0; i < count; ++i) {
      wanted_.push_back(i);
      any = any || place(i) >= 0;
    }
    if (!any) return;
    if (planes_.size() < wanted_.size()) {
      planes_.resize(wanted_.size());
      sheets_.resize(wanted_.size());
    }
    const bool has_more = expects_more_;
    Sums sums;
    (has_more ? more_ : search_).search(cell, wanted_, [&](int i, const Neighbours& near) {
      fit(near, has_more ? LANES : FITS, planes_[i], sums);
      sheets_[i] = find_sheets(near, planes_[i], sums);
    });
    const double noise = find_noise(count);
    wanted_.clear();
    int asked = 0;
    for (int i = 0; i < count; ++i) {
      if (place(i) < 0) continue;
      ++asked;
      const int best = choose(planes_[i], 0, FITS, noise);
      if (sheets_[i].are_told) {
        write(sheets_[i].normal, sheets_[i].square, unit_, vectors_ + 3 * place(i));
      } else if (best == FITS - 1) {
        wanted_.push_back(i);
      } else {
        take(planes_[i], best, unit_, vectors_ + 3 * place(i));
      }
    }
    if (!has_more) more_.search(cell, wanted_, [&](int i, const Neighbours& near) { fit(near, LANES, planes_[i], sums); });
    for (const int i : wanted_)
      take(planes_[i], choose(planes_[i], FITS - 1, MORE_FITS, noise), unit_, vectors_ + 3 * place(i));
    expects_more_ = 2 * static_cast<int>(wanted_.size()) > asked;
  }

 private:
  const UnitPoints& points_;
  const int64_t* place_of_;
  const double unit_;
  float* vectors_;
  // Return the median of the residuals' squares.
  double find_noise(int count) {
    squares_.clear();
    for (int i = 0; i < count; ++i)
      squares_.push_back(sheets_[i].are_told ? sheets_[i].square : planes_[i].squares[NOISE_COUNT]);
    const auto middle = squares_.begin() + count / 2;
    std::nth_element(squares_.begin(), middle, squares_.end());
    return *middle;
  }

  NearestSearch search_, more_;
  bool expects_more_ = false;  // most points of the last cell were given more: one search finds all
  std::vector<int> wanted_;
  std::vector<Planes> planes_;
  std::vector<Sheets> sheets_;
  std::vector<double> squares_;
};

Output<float> fit_planes(Doubles positions, Bytes asked_of, Doubles low_of, double spacing, int64_t threads) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const int64_t count = rows_of(positions);
  const uint8_t* asked = check<uint8_t>(asked_of, "asked", {count});
  const double* low = check<double>(low_of, "low", {3});
  check_positive(spacing, "spacing");
  if (count >= INT32_MAX) refuse("positions: too many points");
  const int workers = check_threads(threads);
  int64_t wanted = 0;
  Buffer<float> vectors;
  {
    const Unlocked unlocked;
    auto place_of = make_buffer<int64_t>(count);
    for (int64_t i = 0; i < count; ++i) place_of[i] = asked[i] ? wanted++ : -1;
    vectors = make_buffer<float>(3 * wanted);
    const UnitPoints points = place_points(point, count, low, spacing);
    run_ranges(points.cells(), workers, [&](int64_t start, int64_t stop) {
      PlaneFitter fitter(points, place_of.get(), spacing / UNITS, vectors.get());
      for (int64_t cell = start; cell < stop; ++cell) fitter.fit_cell(cell);
    });
  }
  return give(std::move(vectors), {static_cast<size_t>(wanted), 3});
}

}  // namespace

HPC_KERNELS {
  module.def("fit_planes", &fit_planes, "positions"_a, "asked"_a, "low"_a, "spacing"_a, "threads"_a = 1);
}

}  // namespace hpc
