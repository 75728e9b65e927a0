// The evaluation grid, and which nodes exist inside a brick, on its faces and edges (see strides.py).
#pragma once

#include <algorithm>
#include <cstdint>

#include "arrays.h"
#include "constants.h"
#include "lattice/keys.h"

namespace hpc {

using constants::grid::BRICK, constants::grid::MOST_SHIFT, constants::grid::NODES;
constexpr int BRICK_NODES = NODES * NODES * NODES;

// The strides of some bricks, as powers of two, and that of all others.
struct Strides {
  bool differ = false;  // false where all are 1
  const int64_t* keys = nullptr;
  const uint8_t* exponents = nullptr;
  int64_t count = 0;
  uint8_t rest = MOST_SHIFT;
  Input keys_of, exponents_of;  // what the pointers point into

  int at(int64_t key) const {
    if (!differ) return 0;
    const int64_t row = std::lower_bound(keys, keys + count, key) - keys;
    return row < count && keys[row] == key ? exponents[row] : rest;
  }

  // Of a brick and those before and behind it along z.
  void around(int64_t key, uint8_t (&shifts)[3]) const {
    int64_t row = std::lower_bound(keys, keys + count, key - 1) - keys;
    for (int i = 0; i < 3; ++i) {
      const bool is_listed = row < count && keys[row] == key - 1 + i;
      shifts[i] = is_listed ? exponents[row++] : rest;
    }
  }
};

struct Grid {
  double origin[3], step;
  int64_t bricks[3];
  Strides strides;
};

// Check a `Grid` of Python.
Grid take_grid(nb::handle given);

// Whether a node, by its place along an axis, is the first of a brick, an inner one, or the last.
inline int end_of(int place) { return place == 0 ? 0 : place == BRICK ? 2 : 1; }

// How far apart the nodes are on the lines through a brick, as powers of two: inside it at [1][1][1],
// on its faces and on its edges at ends of one or two axes.
struct LineShifts {
  uint8_t at[3][3][3] = {};

  int own() const { return at[1][1][1]; }
  int finest() const { return *std::min_element(&at[0][0][0], &at[0][0][0] + 27); }
  // Cells along the edge of the lattice of all its nodes, of which some do not exist.
  int cells() const { return BRICK >> finest(); }
  bool are_zero() const { return *std::max_element(&at[0][0][0], &at[0][0][0] + 27) == 0; }

  // Of the line through a node along an axis.
  int along(int axis, const int* node) const {
    int end[3] = {end_of(node[0]), end_of(node[1]), end_of(node[2])};
    end[axis] = 1;
    return at[end[0]][end[1]][end[2]];
  }

  // Of the lines in the plane through a node across an axis.
  int across(int axis, const int* node) const {
    int end[3] = {1, 1, 1};
    end[axis] = end_of(node[axis]);
    return at[end[0]][end[1]][end[2]];
  }
};

LineShifts line_shifts(const Grid& grid, const Place& place);

// Spread the values of the lattice of a brick's nodes over all places. One without a node has the value
// of the next node below it, along all axes.
void spread_nodes(const float* nodes, const LineShifts& shifts, float* values);

}  // namespace hpc
