// Fits two or three quadrics around the vertices at edges and corners (see features.py).
#include <cmath>

#include "arrays.h"
#include "constants.h"
#include "feature_blend.h"
#include "quadrics/moments.h"
#include "threads.h"

namespace hpc {
namespace {

using namespace constants::features;

inline double dot(const Vec& a, const Vec& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec add(const Vec& a, const Vec& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec scaled(const Vec& a, double by) { return {a.x * by, a.y * by, a.z * by}; }
inline Vec unit(const Vec& a) {
  const double length = std::max(std::sqrt(dot(a, a)), 1e-12);
  return {a.x / length, a.y / length, a.z / length};
}

// Solve a symmetric positive definite system in place by Cholesky; false where it is not.
template <int N>
bool solve(double (&a)[N][N], double (&b)[N]) {
  for (int j = 0; j < N; ++j) {
    double pivot = a[j][j];
    for (int k = 0; k < j; ++k) pivot -= a[j][k] * a[j][k];
    if (!(pivot > 1e-14)) return false;
    const double root = std::sqrt(pivot);
    a[j][j] = root;
    for (int i = j + 1; i < N; ++i) {
      double sum = a[i][j];
      for (int k = 0; k < j; ++k) sum -= a[i][k] * a[j][k];
      a[i][j] = sum / root;
    }
  }
  for (int i = 0; i < N; ++i) {
    double sum = b[i];
    for (int k = 0; k < i; ++k) sum -= a[i][k] * b[k];
    b[i] = sum / a[i][i];
  }
  for (int i = N - 1; i >= 0; --i) {
    double sum = b[i];
    for (int k = i + 1; k < N; ++k) sum -= a[k][i] * b[k];
    b[i] = sum / a[i][i];
  }
  return true;
}

// Exponents of x, y, z in the basis of a quadric.
constexpr int POWERS[BASIS][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {2, 0, 0},
                                    {0, 2, 0}, {0, 0, 2}, {1, 1, 0}, {0, 1, 1}, {1, 0, 1}};

// The weighted sum of squared distances to one quadric fitted to all points.
double fit_one(const PointsAround& points, double noise) {
  double moments[5][5][5], flux[3][4];
  sum_moments(points, moments, flux);
  double a[BASIS][BASIS], b[BASIS];
  const double lam = std::max(noise / NORMAL_VARIANCE, LEAST_LAM);
  for (int i = 0; i < BASIS; ++i) {
    b[i] = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
      if (!POWERS[i][axis]) continue;
      int rest = 0;  // what is left of the monomial: 1 or a coordinate
      for (int k = 0; k < 3; ++k)
        if (POWERS[i][k] - (k == axis) > 0) rest = k + 1;
      b[i] += lam * POWERS[i][axis] * flux[axis][rest];
    }
    for (int j = 0; j <= i; ++j) {
      int e[3];
      for (int k = 0; k < 3; ++k) e[k] = POWERS[i][k] + POWERS[j][k];
      double sum = moments[e[0]][e[1]][e[2]];
      for (int k = 0; k < 3; ++k) {
        const int both = POWERS[i][k] * POWERS[j][k];
        if (both) sum += lam * both * moments[e[0] - 2 * (k == 0)][e[1] - 2 * (k == 1)][e[2] - 2 * (k == 2)];
      }
      a[i][j] = sum;
    }
    a[i][i] += 1e-9 * points.count;
  }
  if (!solve(a, b)) return 0.0;
  Quadric q;
  std::copy(b, b + BASIS, q.c);
  return sum_squares(points, q);
}

// Fit a height over the plane across `axis` to the points of one piece.
bool fit_piece(const PointsAround& points, const double* share, const Vec& axis, double noise, Quadric& out) {
  const double sign = axis.z < 0.0 ? -1.0 : 1.0, s = -1.0 / (sign + axis.z), r = axis.x * axis.y * s;
  const Vec t{1.0 + sign * axis.x * axis.x * s, sign * r, -sign * axis.x}, u{r, sign + axis.y * axis.y * s, -axis.y};
  PlaneSums sums;
  sum_plane(points, share, {t, u, axis}, std::max(noise, EXACT) / NORMAL_VARIANCE, sums);
  double (&b)[HEIGHT] = sums.right;
  double a[HEIGHT][HEIGHT];
  const double ridge = std::max(noise, EXACT) / (CURVATURE * CURVATURE);
  for (int i = 0; i < HEIGHT; ++i) {
    const int *e = TERMS[i];
    for (int j = 0; j <= i; ++j) {
      const int *f = TERMS[j], k = e[0] + f[0], l = e[1] + f[1];
      a[i][j] = sums.moments[k][l];
      if (e[0] && f[0]) a[i][j] += e[0] * f[0] * sums.slopes[k - 2][l];
      if (e[1] && f[1]) a[i][j] += e[1] * f[1] * sums.slopes[k][l - 2];
    }
    a[i][i] += i < 3 ? 1e-6 : ridge;
  }
  if (!solve(a, b)) return false;
  // f = axis . p - height
  const double xx = b[3], xy = b[4], yy = b[5];
  out = {{-b[0], axis.x - b[1] * t.x - b[2] * u.x, axis.y - b[1] * t.y - b[2] * u.y, axis.z - b[1] * t.z - b[2] * u.z,
          -(xx * t.x * t.x + xy * t.x * u.x + yy * u.x * u.x), -(xx * t.y * t.y + xy * t.y * u.y + yy * u.y * u.y),
          -(xx * t.z * t.z + xy * t.z * u.z + yy * u.z * u.z),
          -(2 * xx * t.x * t.y + xy * (t.x * u.y + t.y * u.x) + 2 * yy * u.x * u.y),
          -(2 * xx * t.y * t.z + xy * (t.y * u.z + t.z * u.y) + 2 * yy * u.y * u.z),
          -(2 * xx * t.z * t.x + xy * (t.z * u.x + t.x * u.z) + 2 * yy * u.z * u.x)}};
  return true;
}

struct Model {
  int count = 0;
  Vec axis[PIECES];
  Quadric piece[PIECES];
  Taken taken;
  int first = 0;  // the piece outside of the inner joint
  unsigned joint = 0;
  double sum = 0.0;

  // The distances to the pieces, joined.
  void join(const PointsAround& points, int outside, unsigned by, double* joined) const {
    const int b = (outside + 1) % count, c = count == 3 ? (outside + 2) % 3 : b;
    join_distances(points, taken.distance[outside], taken.distance[b], taken.distance[c], by, joined);
  }
};

bool fit_pieces(const PointsAround& points, double noise, Model& model) {
  Taken& taken = model.taken;
  for (int k = 0; k < model.count; ++k) {
    if (!fit_piece(points, taken.share[k], model.axis[k], noise, model.piece[k])) return false;
    rate_by_piece(points, model.piece[k], taken.cost[k], taken.distance[k]);
  }
  return true;
}

// Find the pieces, given an axis of each to begin with; false where one has too few points.
bool split(const PointsAround& points, double noise, Model& model) {
  for (int k = 0; k < model.count; ++k) std::fill_n(model.taken.share[k], points.padded, -1.0);
  bool settled = false;  // what has not changed in a round will not in the next
  for (int round = 0; round < ROUNDS; ++round) {
    const bool by_pieces = round >= BY_PIECES;
    if (by_pieces && !fit_pieces(points, noise, model)) return false;
    if (!by_pieces)
      for (int k = 0; k < model.count; ++k) rate_by_axis(points, model.axis[k], model.taken.cost[k]);
    double sums[PIECES][4];
    const bool changed = take_points(points, model.count, model.taken, sums);
    for (int k = 0; k < model.count; ++k)
      if (sums[k][0] < LEAST_OF_PIECE) return false;
    for (int k = 0; k < model.count; ++k) model.axis[k] = unit({sums[k][1], sums[k][2], sums[k][3]});
    if (changed) continue;
    settled = by_pieces;
    if (settled) break;
    round = BY_PIECES - 1;
  }
  if (!settled && !fit_pieces(points, noise, model)) return false;
  model.sum = 1e300;
  for (int first = 0; first < (model.count == 3 ? 3 : 1); ++first)
    for (unsigned joint = 0; joint < 4; ++joint) {
      double left[MOST];
      model.join(points, first, joint, left);
      const double sum = sum_products(points, left, left);
      if (sum < model.sum * (1.0 - TIED) - TIED) model.sum = sum, model.first = first, model.joint = joint;
    }
  return true;
}

// How much what a model leaves at a point is like what it leaves at the nearest other one: 0 of noise.
double correlate(const PointsAround& points, const Model& model) {
  double left[MOST], beside[MOST] = {};
  model.join(points, model.first, model.joint, left);
  for (int i = 0; i < points.count; ++i) beside[i] = left[find_nearest(points, i)];
  return sum_products(points, left, beside) / std::max(sum_products(points, left, left), 1e-30);
}

// One quadric does; pieces do not, but might for fewer points; pieces do.
enum class Verdict { ONE, NONE, PIECES };

// The point whose normal turns farthest from all of some directions, the first of several; 1 - cos of by how much.
std::pair<int, double> turn_most(const PointsAround& points, std::initializer_list<Vec> directions) {
  double off[MOST], most = -1.0;
  for (int i = 0; i < points.count; ++i) {
    double along = -2.0;
    for (const Vec& direction : directions) along = std::max(along, dot(points.normal_of(i), direction));
    off[i] = 1.0 - along;
    most = std::max(most, off[i]);
  }
  int worst = 0;
  while (off[worst] < most - TIED) ++worst;
  return {worst, most};
}

// Find the quadrics around a vertex.
Verdict find_features(const PointsAround& points, double noise, Model& best) {
  const double n = points.total;
  const int count = points.count;
  if (n < LEAST_WEIGHT) return Verdict::ONE;
  Vec sum{0, 0, 0};
  for (int i = 0; i < count; ++i) sum = add(sum, scaled(points.normal_of(i), points.weight[i]));
  if (1.0 - dot(sum, sum) / (n * n) < LEAST_SPREAD) return Verdict::ONE;
  Vec inner{0, 0, 0};
  double share = 0.0;
  for (int i = 0; i < count; ++i) {
    const double far = std::max({std::fabs(points.at[0][i]), std::fabs(points.at[1][i]), std::fabs(points.at[2][i])});
    const double near = far > NEAR ? 0.0 : 1.0;
    inner = add(inner, scaled(points.normal_of(i), near));
    share += near;
  }
  if (1.0 - dot(inner, inner) / std::max(share * share, 1.0) < LEAST_NEAR) return Verdict::ONE;
  const Vec mean = unit(sum);
  const double one = fit_one(points, noise) / std::max(1.0, n - BASIS);
  const double bound = GAIN + GAIN_PER_ROOT / std::sqrt(n);
  if (one < bound * std::max(KNOWN * noise, SMALLEST)) return Verdict::ONE;
  const Vec a = points.normal_of(turn_most(points, {mean}).first), b = points.normal_of(turn_most(points, {a}).first);
  best.count = 2;
  best.axis[0] = a, best.axis[1] = b;
  const bool two = split(points, noise, best);
  double variance = two ? best.sum / std::max(1.0, n - 2 * HEIGHT) : 1e300;
  if (n >= LEAST_OF_THREE && !(variance < ENOUGH * noise + SMALLEST)) {
    Model three;
    three.count = 3;
    three.axis[0] = best.axis[0], three.axis[1] = best.axis[1];
    const auto [worst, most] = turn_most(points, {best.axis[0], best.axis[1]});
    three.axis[2] = points.normal_of(worst);
    if (most > LEAST_TURN && split(points, noise, three)) {
      const double other = three.sum / std::max(1.0, n - 3 * HEIGHT);
      if (other + SMALLEST + KNOWN * noise < (variance + SMALLEST + KNOWN * noise) / THIRD || !two) {
        best = three;
        variance = other;
      }
    }
  }
  if (variance >= 1e300) return Verdict::NONE;
  for (int i = 0; i < best.count; ++i)
    for (int j = 0; j < i; ++j)
      if (dot(best.axis[i], best.axis[j]) > ANGLE) return Verdict::NONE;
  if (!(one > bound * std::max({variance, KNOWN * noise, SMALLEST}))) return Verdict::NONE;
  if (!(variance < ADEQUATE * noise + SMALLEST || variance < RELATIVE * one ||
        correlate(points, best) < CORRELATION)) return Verdict::NONE;
  return Verdict::PIECES;
}

struct Cells {
  const int64_t *keys, *offsets;
  int64_t count;
  const double *local, *normals;
};

// Gather the points of the cells around a vertex, `reach` cells on each side; of too many, some.
void gather(const Cells& cells, std::vector<Finger>& fingers, const Place& vertex, int reach, PointsAround& points) {
  struct Run {
    int64_t start, stop;
    double shift[3];
  };
  std::vector<Run> runs;
  int64_t total = 0;
  for (int x = -reach; x < reach; ++x)
    for (int y = -reach; y < reach; ++y) {
      const Place first{vertex[0] + x, vertex[1] + y, vertex[2] - reach};
      if (!in_range(first[0]) || !in_range(first[1]) || !in_range(first[2])) continue;
      const int64_t low = pack(first);
      Finger& finger = fingers[static_cast<size_t>((x + reach) * 2 * reach + y + reach)];
      for (int64_t row = finger.lower_bound(low); row < cells.count && cells.keys[row] < low + 2 * reach; ++row) {
        const double z = static_cast<double>(cells.keys[row] - low - reach);
        runs.push_back({cells.offsets[row], cells.offsets[row + 1], {x + 0.5, y + 0.5, z + 0.5}});
        total += cells.offsets[row + 1] - cells.offsets[row];
      }
    }
  const int64_t every = std::max<int64_t>(1, (total + MOST - 1) / MOST);
  points.count = 0;
  points.total = 0.0;
  int64_t seen = 0;
  for (const Run& run : runs)
    for (int64_t i = run.start; i < run.stop; ++i)
      if (seen++ % every == 0) {
        const double *p = cells.local + 3 * i, *n = cells.normals + 3 * i;
        double far = 1.0;
        for (int axis = 0; axis < 3; ++axis) {
          const double at = p[axis] + run.shift[axis];
          points.at[axis][points.count] = at, points.normal[axis][points.count] = n[axis];
          far = std::max(far, std::fabs(at));
        }
        const double weight = 1.0 - (1.0 - OUTERMOST) * (far - 1.0) / (reach - 1.0);
        points.weight[points.count++] = weight;
        points.total += weight;
      }
  for (points.padded = points.count; points.padded % LANES; ++points.padded) {
    for (int axis = 0; axis < 3; ++axis) points.at[axis][points.padded] = points.normal[axis][points.padded] = 0.0;
    points.weight[points.padded] = 0.0;
  }
}

nb::tuple fit_features(Integers vertices_of, Integers cells_of, Integers offsets_of, Doubles local_of, Doubles normals_of,
                       double noise, int64_t threads) {
  const int64_t* vertices = check_keys(vertices_of, "vertices");
  const int64_t count = rows_of(vertices_of), points = rows_of(local_of), known = rows_of(cells_of);
  const Cells cells{check_keys(cells_of, "cells"), check_offsets(offsets_of, known, points), known,
                    check<double>(local_of, "local_positions", {points, 3}),
                    check<double>(normals_of, "normals", {points, 3})};
  if (!(noise >= 0.0)) refuse("noise: expected 0 or more");
  const int workers = check_threads(threads);
  auto pieces = make_buffer<float>(count * PIECES * BASIS);
  auto joints = make_buffer<uint8_t>(count);
  std::fill(pieces.get(), pieces.get() + count * PIECES * BASIS, 0.0f);
  {
    const Unlocked unlocked;
    run_ranges(count, workers, [&](int64_t start, int64_t stop) {
      std::vector<std::vector<Finger>> fingers;
      for (int reach : REACHES) fingers.emplace_back(4 * reach * reach, Finger(cells.keys, cells.count));
      for (int64_t v = start; v < stop; ++v) {
        joints[v] = 255;
        const Place place = unpack(vertices[v]);
        for (int reach : REACHES) {
          PointsAround around;
          Model model;
          gather(cells, fingers[static_cast<size_t>(3 - reach)], place, reach, around);
          const Verdict verdict = find_features(around, noise, model);
          if (verdict == Verdict::ONE) break;
          if (verdict == Verdict::NONE) continue;
          const int order[PIECES] = {model.first, (model.first + 1) % model.count,
                                     model.count == 3 ? (model.first + 2) % 3 : (model.first + 1) % 2};
          for (int k = 0; k < PIECES; ++k)
            for (int i = 0; i < BASIS; ++i)
              pieces[(v * PIECES + k) * BASIS + i] = static_cast<float>(model.piece[order[k]].c[i]);
          joints[v] = static_cast<uint8_t>(model.joint);
          break;
        }
      }
    });
  }
  return nb::make_tuple(give(std::move(pieces), {static_cast<size_t>(count), PIECES, BASIS}),
                        give(std::move(joints), {static_cast<size_t>(count)}));
}

}  // namespace

HPC_KERNELS {
  module.def("fit_features", &fit_features, "vertices"_a, "cells"_a, "offsets"_a, "local_positions"_a, "normals"_a,
             "noise"_a, "threads"_a = 1);
}

}  // namespace hpc
