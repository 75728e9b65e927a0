// Trilinear weights on a cubic grid.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace hpc {

// The lower node of a place, and how far beyond it the place lies; as trilinear weights need it.
struct Spot {
  int64_t node;
  double local[3];
};

inline Spot spot_of(const double* place, int64_t side) {
  Spot spot{0, {0, 0, 0}};
  for (int axis = 0; axis < 3; ++axis) {
    const double lower = std::min(std::max(std::floor(place[axis]), 0.0), static_cast<double>(side - 2));
    spot.node = spot.node * side + static_cast<int64_t>(lower);
    spot.local[axis] = place[axis] - lower;
  }
  return spot;
}

// Call body(node, weight) for the eight nodes around a place.
template <class Body>
inline void visit_corners(const Spot& spot, int64_t side, const Body& body) {
  for (int octant = 0; octant < 8; ++octant) {
    double factor[3];
    for (int axis = 0; axis < 3; ++axis)
      factor[axis] = (octant >> axis & 1) ? spot.local[axis] : 1.0 - spot.local[axis];
    const int64_t step = ((octant & 1) * side + (octant >> 1 & 1)) * side + (octant >> 2);
    body(spot.node + step, factor[0] * factor[1] * factor[2]);
  }
}

}  // namespace hpc
