// Where the nodes of a brick lie among the layers of a lattice, axis by axis.
#pragma once

#include <cmath>
#include <cstdint>

#include "field.h"

namespace hpc {

constexpr int MOST_LAYERS = 2 * NODES;
// The layers of a lattice that a brick's nodes need along one axis, and where each node is.
struct Axis {
  int count = 0;
  int64_t layer[MOST_LAYERS];
  int below[NODES];
  double local[NODES], weight[NODES];
};

inline Axis locate(int64_t brick, double step, double offset, double size) {
  Axis axis;
  int64_t lower[NODES];
  for (int i = 0; i < NODES; ++i) {
    const double coordinate = (static_cast<double>(brick * BRICK + i) * step + offset) / size;
    const double cell = std::floor(coordinate);
    const double t = coordinate - cell;
    lower[i] = static_cast<int64_t>(cell);
    axis.local[i] = t;
    axis.weight[i] = t * t * (3.0 - 2.0 * t);
  }
  // A lattice much finer than the grid: nine separate pairs of layers.
  const bool apart = lower[NODES - 1] - lower[0] + 2 > MOST_LAYERS;
  axis.count = apart ? MOST_LAYERS : static_cast<int>(lower[NODES - 1] - lower[0] + 2);
  for (int i = 0; i < axis.count; ++i) axis.layer[i] = apart ? lower[i / 2] + i % 2 : lower[0] + i;
  for (int i = 0; i < NODES; ++i) axis.below[i] = apart ? 2 * i : static_cast<int>(lower[i] - lower[0]);
  return axis;
}

}  // namespace hpc
