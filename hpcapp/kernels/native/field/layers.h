// Where the nodes of a brick lie among the layers of a lattice, axis by axis.
#pragma once

#include <cmath>
#include <cstdint>

#include "field.h"

namespace hpc {

constexpr int MOST_LAYERS = 2 * NODES;
// The layers of a lattice that a brick's nodes need along one axis, and where each node is.
struct Axis {
  int nodes = 0, count = 0;
  int64_t layer[MOST_LAYERS];
  int below[NODES];
  double local[NODES], weight[NODES];
};

// Locate every so many nodes of a brick.
inline Axis locate(int64_t brick, int every, double step, double offset, double size) {
  Axis axis;
  axis.nodes = BRICK / every + 1;
  int64_t lower[NODES] = {};
  for (int i = 0; i < axis.nodes; ++i) {
    const double coordinate = (static_cast<double>(brick * BRICK + i * every) * step + offset) / size;
    const double cell = std::floor(coordinate);
    const double t = coordinate - cell;
    lower[i] = static_cast<int64_t>(cell);
    axis.local[i] = t;
    axis.weight[i] = t * t * (3.0 - 2.0 * t);
  }
  // A lattice much finer than the nodes: separate pairs of layers.
  const int64_t span = lower[axis.nodes - 1] - lower[0] + 2;
  const bool apart = span > 2 * axis.nodes;
  axis.count = apart ? 2 * axis.nodes : static_cast<int>(span);
  for (int i = 0; i < axis.count; ++i) axis.layer[i] = apart ? lower[i / 2] + i % 2 : lower[0] + i;
  for (int i = 0; i < axis.nodes; ++i) axis.below[i] = apart ? 2 * i : static_cast<int>(lower[i] - lower[0]);
  return axis;
}

}  // namespace hpc
