// Joined quadrics over bricks (see feature_blend.py): few vertices have them, so nothing here is vectorised.
#include "feature_blend.h"

namespace hpc {
namespace {

inline Real quadric_at(const float* c, Real x, Real y, Real z) {
  return c[0] + x * (c[1] + x * c[4] + y * c[7]) + y * (c[2] + y * c[5] + z * c[8]) + z * (c[3] + z * c[6] + x * c[9]);
}

}  // namespace

bool FeatureBlend::find(const Axis* axes) {
  found_.clear();
  if (!features_.count) return false;
  for (int x = 0; x < axes[0].count; ++x)
    for (int y = 0; y < axes[1].count; ++y)
      for (int z = 0; z < axes[2].count; ++z) {
        const Place place{axes[0].layer[x], axes[1].layer[y], axes[2].layer[z]};
        if (!in_range(place[0]) || !in_range(place[1]) || !in_range(place[2])) continue;
        const int64_t key = pack(place), row = finger_.lower_bound(key);
        if (row == features_.count) return !found_.empty();
        const int64_t ahead = features_.keys[row] - key;
        if (!ahead) {
          found_.push_back({{x, y, z}, row});
        } else if (axes[2].layer[axes[2].count - 1] - place[2] < ahead) {
          break;
        }
      }
  return !found_.empty();
}

void FeatureBlend::add(const Axis* axes, const Real* raw, int64_t plane, int64_t lanes, Real scale, Real* total,
                       const Real* before, const Real* rest, int64_t stride) const {
  const int64_t channel = axes[2].count * plane;
  for (const Found& found : found_) {
    const float* pieces = features_.pieces + found.row * PIECES * BASIS;
    const Real* own = raw + found.at[2] * plane + found.at[1] * lanes + found.at[0];
    float smooth[BASIS];
    for (int i = 0; i < BASIS; ++i) smooth[i] = own[i * channel];
    const unsigned joint = features_.joints[found.row];
    // The weight and the place of each node along each axis; no weight beyond a cell.
    Real weight[3][NODES], local[3][NODES];
    int first[3], end[3];
    for (int axis = 0; axis < 3; ++axis) {
      first[axis] = NODES, end[axis] = 0;
      for (int i = 0; i < axes[axis].nodes; ++i) {
        const int above = found.at[axis] - axes[axis].below[i];
        if (above != 0 && above != 1) continue;
        weight[axis][i] = static_cast<Real>(above ? axes[axis].weight[i] : 1.0 - axes[axis].weight[i]);
        local[axis][i] = static_cast<Real>(above ? axes[axis].local[i] - 1.0 : axes[axis].local[i]);
        first[axis] = std::min(first[axis], i), end[axis] = i + 1;
      }
    }
    for (int i = first[0]; i < end[0]; ++i)
      for (int j = first[1]; j < end[1]; ++j)
        for (int k = first[2]; k < end[2]; ++k) {
          const Real x = local[0][i], y = local[1][j], z = local[2][k];
          Real values[PIECES];
          for (int piece = 0; piece < PIECES; ++piece) values[piece] = quadric_at(pieces + piece * BASIS, x, y, z);
          const Real inner = joint & 2 ? std::min(values[1], values[2]) : std::max(values[1], values[2]);
          const Real joined = joint & 1 ? std::min(values[0], inner) : std::max(values[0], inner);
          Real presence = 0;
          for (int corner = 0; corner < 8; ++corner) {
            const int a = corner & 1, b = corner >> 1 & 1, c = corner >> 2;
            const auto share = [&](int axis, int node, int high) {
              return static_cast<Real>(high ? axes[axis].weight[node] : 1.0 - axes[axis].weight[node]);
            };
            presence += share(0, i, a) * share(1, j, b) * share(2, k, c) *
                        raw[BASIS * channel + (axes[2].below[k] + c) * plane + (axes[1].below[j] + b) * lanes +
                            axes[0].below[i] + a];
          }
          const Real share = weight[0][i] * weight[1][j] * weight[2][k] / (presence > 0 ? presence : 1);
          const int64_t node = i * stride + j * axes[2].nodes + k;
          total[node] += (before[node] - rest[node]) * share * scale * (joined - quadric_at(smooth, x, y, z));
        }
  }
}

}  // namespace hpc
