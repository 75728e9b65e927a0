// Sums over the points around a vertex (see feature_points.h).
#include "feature_points.h"

#include <algorithm>
#include <cmath>

#include "clones.h"
#include "quadrics/moments.h"

namespace hpc {
namespace {

using namespace constants::features;

static_assert(MOST % LANES == 0, "blocks are whole");

HPC_INLINE double add_lanes(const double (&lanes)[LANES]) {
  double sum = lanes[0];
  for (int lane = 1; lane < LANES; ++lane) sum += lanes[lane];
  return sum;
}

HPC_INLINE double value_at(const double* c, double x, double y, double z) {
  return c[0] + x * (c[1] + x * c[4] + y * c[7]) + y * (c[2] + y * c[5] + z * c[8]) + z * (c[3] + z * c[6] + x * c[9]);
}

HPC_INLINE Vec slope_at(const double* c, double x, double y, double z) {
  return {c[1] + 2.0 * c[4] * x + c[7] * y + c[9] * z, c[2] + 2.0 * c[5] * y + c[7] * x + c[8] * z,
          c[3] + 2.0 * c[6] * z + c[8] * y + c[9] * x};
}

}  // namespace

HPC_CLONES void sum_moments(const PointsAround& points, double (&moments)[5][5][5], double (&flux)[3][4]) {
  double sums[5][5][5][LANES] = {}, fluxes[3][4][LANES] = {};
  for (int i = 0; i < points.padded; i += LANES) {
    double by_x[LANES], by_y[LANES], by_z[LANES];
    const double *px = points.at[0] + i, *py = points.at[1] + i, *pz = points.at[2] + i;
    EACH_LANE by_x[lane] = points.weight[i + lane];
    HPC_UNROLLED for (int a = 0; a < 5; ++a) {
      EACH_LANE by_y[lane] = by_x[lane];
      HPC_UNROLLED for (int b = 0; b < 5 - a; ++b) {
        EACH_LANE by_z[lane] = by_y[lane];
        HPC_UNROLLED for (int c = 0; c < 5 - a - b; ++c) EACH_LANE {
            sums[a][b][c][lane] += by_z[lane];
            by_z[lane] *= pz[lane];
          }
        EACH_LANE by_y[lane] *= py[lane];
      }
      EACH_LANE by_x[lane] *= px[lane];
    }
    for (int axis = 0; axis < 3; ++axis) EACH_LANE {
        const double part = points.weight[i + lane] * points.normal[axis][i + lane];
        fluxes[axis][0][lane] += part;
        fluxes[axis][1][lane] += part * px[lane];
        fluxes[axis][2][lane] += part * py[lane];
        fluxes[axis][3][lane] += part * pz[lane];
      }
  }
  for (int a = 0; a < 5; ++a)
    for (int b = 0; a + b < 5; ++b)
      for (int c = 0; a + b + c < 5; ++c) moments[a][b][c] = add_lanes(sums[a][b][c]);
  for (int axis = 0; axis < 3; ++axis)
    for (int k = 0; k < 4; ++k) flux[axis][k] = add_lanes(fluxes[axis][k]);
}

HPC_CLONES double sum_squares(const PointsAround& points, const Quadric& quadric) {
  const double* c = quadric.c;
  double sum[LANES] = {};
  for (int i = 0; i < points.padded; i += LANES) EACH_LANE {
      const double x = points.at[0][i + lane], y = points.at[1][i + lane], z = points.at[2][i + lane];
      const double f = value_at(c, x, y, z);
      const Vec g = slope_at(c, x, y, z);
      const double squared = g.x * g.x + g.y * g.y + g.z * g.z;
      sum[lane] += points.weight[i + lane] * f * f / (squared > LEAST_SLOPE ? squared : LEAST_SLOPE);
    }
  return add_lanes(sum);
}

HPC_CLONES void sum_plane(const PointsAround& points, const double* share, const Vec (&frame)[3], double lam,
                          PlaneSums& sums) {
  const Vec t = frame[0], u = frame[1], axis = frame[2];
  double moments[5][5][LANES] = {}, slopes[HEIGHT][LANES] = {}, right[HEIGHT][LANES] = {};
  for (int i = 0; i < points.padded; i += LANES) {
    double x[LANES], y[LANES], by_x[LANES], by_y[LANES];
    EACH_LANE {
      const double px = points.at[0][i + lane], py = points.at[1][i + lane], pz = points.at[2][i + lane];
      const double nx = points.normal[0][i + lane], ny = points.normal[1][i + lane], nz = points.normal[2][i + lane];
      const double w = share[i + lane];
      x[lane] = px * t.x + py * t.y + pz * t.z;
      y[lane] = px * u.x + py * u.y + pz * u.z;
      by_x[lane] = w;
      const double height = w * (px * axis.x + py * axis.y + pz * axis.z);
      const double along = nx * axis.x + ny * axis.y + nz * axis.z;
      const double weight = along > CONE ? w * lam * (along - CONE) / (1.0 - CONE) : 0.0;
      const double over = -weight / (along > CONE ? along : 1.0);
      const double dx = over * (nx * t.x + ny * t.y + nz * t.z), dy = over * (nx * u.x + ny * u.y + nz * u.z);
      right[0][lane] += height;
      right[1][lane] += height * x[lane] + dx;
      right[2][lane] += height * y[lane] + dy;
      right[3][lane] += height * x[lane] * x[lane] + 2.0 * x[lane] * dx;
      right[4][lane] += height * x[lane] * y[lane] + (y[lane] * dx + x[lane] * dy);
      right[5][lane] += height * y[lane] * y[lane] + 2.0 * y[lane] * dy;
      slopes[0][lane] += weight;
      slopes[1][lane] += weight * x[lane];
      slopes[2][lane] += weight * y[lane];
      slopes[3][lane] += weight * x[lane] * x[lane];
      slopes[4][lane] += weight * x[lane] * y[lane];
      slopes[5][lane] += weight * y[lane] * y[lane];
    }
    HPC_UNROLLED for (int k = 0; k < 5; ++k) {
      EACH_LANE by_y[lane] = by_x[lane];
      HPC_UNROLLED for (int l = 0; l < 5 - k; ++l) EACH_LANE {
          moments[k][l][lane] += by_y[lane];
          by_y[lane] *= y[lane];
        }
      EACH_LANE by_x[lane] *= x[lane];
    }
  }
  for (int k = 0; k < 5; ++k)
    for (int l = 0; k + l < 5; ++l) sums.moments[k][l] = add_lanes(moments[k][l]);
  for (int i = 0; i < HEIGHT; ++i) {
    sums.slopes[TERMS[i][0]][TERMS[i][1]] = add_lanes(slopes[i]);
    sums.right[i] = add_lanes(right[i]);
  }
}

HPC_CLONES void rate_by_axis(const PointsAround& points, const Vec& axis, double* cost) {
  const Vec n = axis;
  for (int i = 0; i < points.padded; i += LANES) EACH_LANE {
      const int at = i + lane;
      cost[at] = 2.0 - 2.0 * (points.normal[0][at] * n.x + points.normal[1][at] * n.y + points.normal[2][at] * n.z);
    }
}

HPC_CLONES void rate_by_piece(const PointsAround& points, const Quadric& piece, double* cost, double* distance) {
  const Quadric q = piece;
  for (int i = 0; i < points.padded; i += LANES) EACH_LANE {
      const int at = i + lane;
      const double x = points.at[0][at], y = points.at[1][at], z = points.at[2][at];
      const Vec g = slope_at(q.c, x, y, z);
      const double squared = g.x * g.x + g.y * g.y + g.z * g.z;
      const double by = 1.0 / std::sqrt(squared > LEAST_SLOPE ? squared : LEAST_SLOPE);
      const double along = points.normal[0][at] * (g.x * by) + points.normal[1][at] * (g.y * by) +
                           points.normal[2][at] * (g.z * by);
      const double off = value_at(q.c, x, y, z) * by;
      distance[at] = off;
      cost[at] = TURN * (2.0 - 2.0 * along) + off * off;
    }
}

HPC_CLONES bool take_points(const PointsAround& points, int pieces, Taken& taken, double (&sums)[PIECES][4]) {
  double lanes[PIECES][4][LANES] = {}, changed[LANES] = {};
  for (int i = 0; i < points.padded; i += LANES) {
    double least[LANES], best[LANES];
    EACH_LANE least[lane] = taken.cost[0][i + lane], best[lane] = 0.0;
    for (int k = 1; k < pieces; ++k) EACH_LANE {
        const double cost = taken.cost[k][i + lane];
        best[lane] = cost < least[lane] - TIED ? static_cast<double>(k) : best[lane];
        least[lane] = cost < least[lane] - TIED ? cost : least[lane];
      }
    for (int k = 0; k < pieces; ++k) EACH_LANE {
        const double share = best[lane] == static_cast<double>(k) ? points.weight[i + lane] : 0.0;
        changed[lane] += taken.share[k][i + lane] == share ? 0.0 : 1.0;
        taken.share[k][i + lane] = share;
        lanes[k][0][lane] += share;
        for (int axis = 0; axis < 3; ++axis) lanes[k][1 + axis][lane] += points.normal[axis][i + lane] * share;
      }
  }
  for (int k = 0; k < pieces; ++k)
    for (int j = 0; j < 4; ++j) sums[k][j] = add_lanes(lanes[k][j]);
  return add_lanes(changed) > 0.0;
}

HPC_CLONES void join_distances(const PointsAround& points, const double* a, const double* b, const double* c,
                               unsigned joint, double* joined) {
  // min(x, y) is -max(-x, -y).
  const double outer = joint & 1 ? -1.0 : 1.0, inner = joint & 2 ? -1.0 : 1.0;
  for (int i = 0; i < points.padded; i += LANES) EACH_LANE {
      const double second = inner * b[i + lane], third = inner * c[i + lane];
      const double rest = outer * (inner * (second < third ? third : second)), first = outer * a[i + lane];
      joined[i + lane] = outer * (first < rest ? rest : first);
    }
}

HPC_CLONES double sum_products(const PointsAround& points, const double* a, const double* b) {
  double sum[LANES] = {};
  for (int i = 0; i < points.padded; i += LANES)
    EACH_LANE sum[lane] += points.weight[i + lane] * a[i + lane] * b[i + lane];
  return add_lanes(sum);
}

HPC_CLONES int find_nearest(const PointsAround& points, int i) {
  const double px = points.at[0][i], py = points.at[1][i], pz = points.at[2][i];
  double gaps[MOST], least[LANES];
  EACH_LANE least[lane] = 1e300;
  for (int j = 0; j < points.padded; j += LANES) EACH_LANE {
      const double x = points.at[0][j + lane] - px, y = points.at[1][j + lane] - py, z = points.at[2][j + lane] - pz;
      const double gap = points.weight[j + lane] > 0.0 && j + lane != i ? x * x + y * y + z * z : 1e300;
      gaps[j + lane] = gap;
      least[lane] = gap < least[lane] ? gap : least[lane];
    }
  for (int lane = 1; lane < LANES; ++lane) least[0] = least[lane] < least[0] ? least[lane] : least[0];
  if (least[0] >= 1e300) return i;
  int nearest = 0;
  while (gaps[nearest] > least[0] + TIED) ++nearest;
  return nearest;
}

}  // namespace hpc
