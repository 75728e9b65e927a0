// Fits two or three quadrics around the vertices at edges and corners (see features.py).
#include <cmath>

#include "families.h"
#include "features.h"
#include "threads.h"

namespace hpc {
namespace {

constexpr int MOST = 160;  // points that a fit looks at
constexpr int HEIGHT = 6;  // coefficients of a height over a plane
constexpr int REACHES[2] = {3, 2};

// As in the portable version, where each is explained.
constexpr double OUTERMOST = 0.15, LEAST_WEIGHT = 9.0, LEAST_OF_THREE = 14.0, LEAST_OF_PIECE = 2.5;
constexpr double LEAST_SPREAD = 0.08, NEAR = 2.0, LEAST_NEAR = 0.02, GAIN = 2.0, GAIN_PER_ROOT = 6.0, ADEQUATE = 2.5, RELATIVE = 0.1;
constexpr double CORRELATION = 0.3, SMALLEST = 2e-4, KNOWN = 0.7, ENOUGH = 1.2, THIRD = 1.3, LEAST_TURN = 0.25, ANGLE = 0.82;
constexpr double NORMAL_VARIANCE = 0.07, LEAST_LAM = 0.2, CONE = 0.7, TURN = 0.2, CURVATURE = 0.08, EXACT = 1e-5;
constexpr double LEAST_SLOPE = 0.04;  // squared
constexpr int ROUNDS = 6, BY_PIECES = 3;

struct Vec {
  double x, y, z;
};
inline double dot(const Vec& a, const Vec& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec add(const Vec& a, const Vec& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec scaled(const Vec& a, double by) { return {a.x * by, a.y * by, a.z * by}; }
inline Vec unit(const Vec& a) {
  const double length = std::max(std::sqrt(dot(a, a)), 1e-12);
  return {a.x / length, a.y / length, a.z / length};
}

struct Points {
  int count = 0;
  Vec at[MOST], normal[MOST];
  double weight[MOST], total = 0.0;
};

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

struct Quadric {
  double c[QUADRIC];

  double value(const Vec& p) const {
    return c[0] + p.x * (c[1] + p.x * c[4] + p.y * c[7]) + p.y * (c[2] + p.y * c[5] + p.z * c[8]) +
           p.z * (c[3] + p.z * c[6] + p.x * c[9]);
  }
  Vec slope(const Vec& p) const {
    return {c[1] + 2.0 * c[4] * p.x + c[7] * p.y + c[9] * p.z, c[2] + 2.0 * c[5] * p.y + c[7] * p.x + c[8] * p.z,
            c[3] + 2.0 * c[6] * p.z + c[8] * p.y + c[9] * p.x};
  }
};

// Exponents of x, y, z in the basis of a quadric.
constexpr int POWERS[QUADRIC][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {2, 0, 0},
                                    {0, 2, 0}, {0, 0, 2}, {1, 1, 0}, {0, 1, 1}, {1, 0, 1}};

// The weighted sum of squared distances to one quadric fitted to all points.
double fit_one(const Points& points, double noise) {
  double moments[5][5][5] = {}, flux[3][4] = {};
  for (int i = 0; i < points.count; ++i) {
    const Vec &p = points.at[i], &n = points.normal[i];
    const double weight = points.weight[i], place[4] = {1.0, p.x, p.y, p.z}, normal[3] = {n.x, n.y, n.z};
    double x = weight;
    for (int a = 0; a < 5; ++a, x *= p.x) {
      double y = x;
      for (int b = 0; a + b < 5; ++b, y *= p.y) {
        double z = y;
        for (int c = 0; a + b + c < 5; ++c, z *= p.z) moments[a][b][c] += z;
      }
    }
    for (int axis = 0; axis < 3; ++axis)
      for (int k = 0; k < 4; ++k) flux[axis][k] += weight * normal[axis] * place[k];
  }
  double a[QUADRIC][QUADRIC], b[QUADRIC];
  const double lam = std::max(noise / NORMAL_VARIANCE, LEAST_LAM);
  for (int i = 0; i < QUADRIC; ++i) {
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
  std::copy(b, b + QUADRIC, q.c);
  double sum = 0.0;
  for (int i = 0; i < points.count; ++i) {
    const double f = q.value(points.at[i]);
    const Vec g = q.slope(points.at[i]);
    sum += points.weight[i] * f * f / std::max(dot(g, g), LEAST_SLOPE);
  }
  return sum;
}

// Exponents of x, y in a height.
constexpr int TERMS[HEIGHT][2] = {{0, 0}, {1, 0}, {0, 1}, {2, 0}, {1, 1}, {0, 2}};

// Fit a height over the plane across `axis` to the points of one piece.
bool fit_piece(const Points& points, const uint8_t* piece_of, int piece, const Vec& axis, double noise, Quadric& out) {
  const double sign = axis.z < 0.0 ? -1.0 : 1.0, s = -1.0 / (sign + axis.z), r = axis.x * axis.y * s;
  const Vec t{1.0 + sign * axis.x * axis.x * s, sign * r, -sign * axis.x}, u{r, sign + axis.y * axis.y * s, -axis.y};
  double moments[5][5] = {}, slopes[3][3] = {}, b[HEIGHT] = {};
  const double lam = std::max(noise, EXACT) / NORMAL_VARIANCE;
  for (int i = 0; i < points.count; ++i) {
    if (piece_of[i] != piece) continue;
    const Vec &p = points.at[i], &n = points.normal[i];
    const double x = dot(p, t), y = dot(p, u), along = dot(n, axis), height = points.weight[i] * dot(p, axis);
    double part = points.weight[i];
    for (int k = 0; k < 5; ++k, part *= x) {
      double term = part;
      for (int l = 0; k + l < 5; ++l, term *= y) moments[k][l] += term;
    }
    b[0] += height, b[1] += height * x, b[2] += height * y;
    b[3] += height * x * x, b[4] += height * x * y, b[5] += height * y * y;
    if (along <= CONE) continue;
    const double weight = points.weight[i] * lam * (along - CONE) / (1.0 - CONE);
    const double over = -weight / along, dx = over * dot(n, t), dy = over * dot(n, u);
    slopes[0][0] += weight, slopes[1][0] += weight * x, slopes[0][1] += weight * y;
    slopes[2][0] += weight * x * x, slopes[1][1] += weight * x * y, slopes[0][2] += weight * y * y;
    b[1] += dx, b[2] += dy;
    b[3] += 2.0 * x * dx, b[4] += y * dx + x * dy, b[5] += 2.0 * y * dy;
  }
  double a[HEIGHT][HEIGHT];
  const double ridge = std::max(noise, EXACT) / (CURVATURE * CURVATURE);
  for (int i = 0; i < HEIGHT; ++i) {
    const int *e = TERMS[i];
    for (int j = 0; j <= i; ++j) {
      const int *f = TERMS[j], k = e[0] + f[0], l = e[1] + f[1];
      a[i][j] = moments[k][l];
      if (e[0] && f[0]) a[i][j] += e[0] * f[0] * slopes[k - 2][l];
      if (e[1] && f[1]) a[i][j] += e[1] * f[1] * slopes[k][l - 2];
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
  uint8_t of[MOST];
  int first = 0;  // the piece outside of the inner joint
  unsigned joint = 0;
  double sum = 0.0, left[MOST];
};

double join(double a, double b, double c, unsigned joint) {
  const double inner = joint & 2 ? std::min(b, c) : std::max(b, c);
  return joint & 1 ? std::min(a, inner) : std::max(a, inner);
}

// What the pieces of a model are to each point.
struct Measures {
  double distance[PIECES][MOST];
  Vec turned[PIECES][MOST];  // the direction of the gradient
};

bool fit_pieces(const Points& points, double noise, Model& model, Measures& found) {
  for (int k = 0; k < model.count; ++k) {
    if (!fit_piece(points, model.of, k, model.axis[k], noise, model.piece[k])) return false;
    for (int i = 0; i < points.count; ++i) {
      const Vec g = model.piece[k].slope(points.at[i]);
      const double by = 1.0 / std::sqrt(std::max(dot(g, g), LEAST_SLOPE));
      found.turned[k][i] = scaled(g, by);
      found.distance[k][i] = model.piece[k].value(points.at[i]) * by;
    }
  }
  return true;
}

// Take each point to the piece that explains it best; tell whether any is another one than before.
bool take_points(const Points& points, const Measures* found, Model& model, double (&members)[PIECES], Vec (&sums)[PIECES]) {
  bool changed = false;
  for (int k = 0; k < model.count; ++k) members[k] = 0.0, sums[k] = {0.0, 0.0, 0.0};
  for (int i = 0; i < points.count; ++i) {
    int best = 0;
    double least = 1e300;
    for (int k = 0; k < model.count; ++k) {
      const Vec& normal = found ? found->turned[k][i] : model.axis[k];
      double cost = 2.0 - 2.0 * dot(points.normal[i], normal);
      if (found) cost = TURN * cost + found->distance[k][i] * found->distance[k][i];
      if (cost < least) least = cost, best = k;
    }
    changed = changed || model.of[i] != best;
    model.of[i] = static_cast<uint8_t>(best);
    members[best] += points.weight[i];
    sums[best] = add(sums[best], scaled(points.normal[i], points.weight[i]));
  }
  return changed;
}

// Find the pieces, given an axis of each to begin with; false where one has too few points.
bool split(const Points& points, double noise, Model& model) {
  Measures found;
  std::fill(model.of, model.of + points.count, uint8_t{PIECES});
  bool settled = false;  // what has not changed in a round will not in the next
  for (int round = 0; round < ROUNDS; ++round) {
    const bool by_pieces = round >= BY_PIECES;
    if (by_pieces && !fit_pieces(points, noise, model, found)) return false;
    double members[PIECES];
    Vec sums[PIECES];
    const bool changed = take_points(points, by_pieces ? &found : nullptr, model, members, sums);
    for (int k = 0; k < model.count; ++k)
      if (members[k] < LEAST_OF_PIECE) return false;
    for (int k = 0; k < model.count; ++k) model.axis[k] = unit(sums[k]);
    if (changed) continue;
    settled = by_pieces;
    if (settled) break;
    round = BY_PIECES - 1;
  }
  if (!settled && !fit_pieces(points, noise, model, found)) return false;
  const auto& distance = found.distance;
  const int n = points.count;
  model.sum = 1e300;
  for (int first = 0; first < (model.count == 3 ? 3 : 1); ++first)
    for (unsigned joint = 0; joint < 4; ++joint) {
      const int b = (first + 1) % model.count, c = model.count == 3 ? (first + 2) % 3 : b;
      double sum = 0.0, left[MOST];
      for (int i = 0; i < n; ++i) {
        const double f = left[i] = join(distance[first][i], distance[b][i], distance[c][i], joint);
        sum += points.weight[i] * f * f;
      }
      if (!(sum < model.sum)) continue;
      model.sum = sum, model.first = first, model.joint = joint;
      std::copy(left, left + n, model.left);
    }
  return true;
}

// How much what a model leaves at a point is like what it leaves at the nearest other one: 0 of noise.
double correlate(const Points& points, const Model& model) {
  double squares = 0.0, products = 0.0;
  for (int i = 0; i < points.count; ++i) {
    int nearest = i;
    double least = 1e300;
    for (int j = 0; j < points.count; ++j) {
      const Vec gap{points.at[j].x - points.at[i].x, points.at[j].y - points.at[i].y, points.at[j].z - points.at[i].z};
      const double square = dot(gap, gap);
      if (j != i && square < least) least = square, nearest = j;
    }
    products += points.weight[i] * model.left[i] * model.left[nearest];
    squares += points.weight[i] * model.left[i] * model.left[i];
  }
  return products / std::max(squares, 1e-30);
}

// One quadric does; pieces do not, but might for fewer points; pieces do.
enum class Verdict { ONE, NONE, PIECES };

// Find the quadrics around a vertex.
Verdict find_features(const Points& points, double noise, Model& best) {
  const double n = points.total;
  const int count = points.count;
  if (n < LEAST_WEIGHT) return Verdict::ONE;
  Vec sum{0, 0, 0};
  for (int i = 0; i < count; ++i) sum = add(sum, scaled(points.normal[i], points.weight[i]));
  if (1.0 - dot(sum, sum) / (n * n) < LEAST_SPREAD) return Verdict::ONE;
  Vec inner{0, 0, 0};
  double share = 0.0;
  for (int i = 0; i < count; ++i) {
    const Vec& p = points.at[i];
    if (std::max({std::fabs(p.x), std::fabs(p.y), std::fabs(p.z)}) > NEAR) continue;
    inner = add(inner, points.normal[i]);
    share += 1.0;
  }
  if (1.0 - dot(inner, inner) / std::max(share * share, 1.0) < LEAST_NEAR) return Verdict::ONE;
  const Vec mean = unit(sum);
  const double one = fit_one(points, noise) / std::max(1.0, n - QUADRIC);
  const double bound = GAIN + GAIN_PER_ROOT / std::sqrt(n);
  if (one < bound * std::max(KNOWN * noise, SMALLEST)) return Verdict::ONE;
  int a = 0, b = 0;
  for (int i = 1; i < count; ++i)
    if (dot(points.normal[i], mean) < dot(points.normal[a], mean)) a = i;
  for (int i = 1; i < count; ++i)
    if (dot(points.normal[i], points.normal[a]) < dot(points.normal[b], points.normal[a])) b = i;
  best.count = 2;
  best.axis[0] = points.normal[a], best.axis[1] = points.normal[b];
  const bool two = split(points, noise, best);
  double variance = two ? best.sum / std::max(1.0, n - 2 * HEIGHT) : 1e300;
  if (n >= LEAST_OF_THREE && !(variance < ENOUGH * noise + SMALLEST)) {
    Model three;
    three.count = 3;
    three.axis[0] = best.axis[0], three.axis[1] = best.axis[1];
    int worst = 0;
    double most = -1.0;
    for (int i = 0; i < count; ++i) {
      const double to0 = dot(points.normal[i], best.axis[0]), to1 = dot(points.normal[i], best.axis[1]);
      const double off = 1.0 - std::max(to0, to1);
      if (off > most) most = off, worst = i;
    }
    three.axis[2] = points.normal[worst];
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
  if (!(variance < ADEQUATE * noise + SMALLEST || variance < RELATIVE * one ||
        correlate(points, best) < CORRELATION)) return Verdict::NONE;
  if (!(one > bound * std::max({variance, KNOWN * noise, SMALLEST}))) return Verdict::NONE;
  return Verdict::PIECES;
}

struct Cells {
  const int64_t *keys, *offsets;
  int64_t count;
  const double *local, *normals;
};

// Gather the points of the cells around a vertex, `reach` cells on each side; of too many, some.
void gather(const Cells& cells, std::vector<Finger>& fingers, const Place& vertex, int reach, Points& points) {
  struct Run {
    int64_t start, stop;
    Vec shift;
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
        points.at[points.count] = {p[0] + run.shift.x, p[1] + run.shift.y, p[2] + run.shift.z};
        const Vec& at = points.at[points.count];
        const double m = std::max({std::fabs(at.x), std::fabs(at.y), std::fabs(at.z), 1.0});
        points.weight[points.count] = 1.0 - (1.0 - OUTERMOST) * (m - 1.0) / (reach - 1.0);
        points.total += points.weight[points.count];
        points.normal[points.count++] = {n[0], n[1], n[2]};
      }
}

nb::tuple fit_features(Input vertices_of, Input cells_of, Input offsets_of, Input local_of, Input normals_of,
                       double noise, int64_t threads) {
  const int64_t* vertices = check_keys(vertices_of, "vertices");
  const int64_t count = rows_of(vertices_of), points = rows_of(local_of), known = rows_of(cells_of);
  const Cells cells{check_keys(cells_of, "cells"), check_offsets(offsets_of, known, points), known,
                    check<double>(local_of, "local_positions", {points, 3}),
                    check<double>(normals_of, "normals", {points, 3})};
  if (!(noise >= 0.0)) refuse("noise: expected 0 or more");
  const int workers = check_threads(threads);
  auto pieces = make_buffer<float>(count * PIECES * QUADRIC);
  auto joints = make_buffer<uint8_t>(count);
  std::fill(pieces.get(), pieces.get() + count * PIECES * QUADRIC, 0.0f);
  {
    nb::gil_scoped_release unlocked;
    run_ranges(count, workers, [&](int64_t start, int64_t stop) {
      std::vector<std::vector<Finger>> fingers;
      for (int reach : REACHES) fingers.emplace_back(4 * reach * reach, Finger(cells.keys, cells.count));
      for (int64_t v = start; v < stop; ++v) {
        joints[v] = 255;
        const Place place = unpack(vertices[v]);
        for (int reach : REACHES) {
          Points around;
          Model model;
          gather(cells, fingers[static_cast<size_t>(3 - reach)], place, reach, around);
          const Verdict verdict = find_features(around, noise, model);
          if (verdict == Verdict::ONE) break;
          if (verdict == Verdict::NONE) continue;
          const int order[PIECES] = {model.first, (model.first + 1) % model.count,
                                     model.count == 3 ? (model.first + 2) % 3 : (model.first + 1) % 2};
          for (int k = 0; k < PIECES; ++k)
            for (int i = 0; i < QUADRIC; ++i)
              pieces[(v * PIECES + k) * QUADRIC + i] = static_cast<float>(model.piece[order[k]].c[i]);
          joints[v] = static_cast<uint8_t>(model.joint);
          break;
        }
      }
    });
  }
  return nb::make_tuple(give(std::move(pieces), {static_cast<size_t>(count), PIECES, QUADRIC}),
                        give(std::move(joints), {static_cast<size_t>(count)}));
}

}  // namespace

void bind_features(nb::module_& module) { module.def("fit_features", &fit_features); }

}  // namespace hpc
