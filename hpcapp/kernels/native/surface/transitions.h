// Vertices and faces of a brick whose stride, or that of one beside it, is not 1 (see transitions.py).
#pragma once

#include <cstdint>
#include <vector>

#include "brick_signs.h"

namespace hpc {

// An edge of a brick: its axis and its lower node.
struct Edge {
  int axis, node[3];
};

// A closed line on the faces of a cell: its vertices, the quad that it crosses from each to the next,
// the edge of the cell that each lies on, different negative numbers where none, and whether diagonals
// along that edge are the cell's to make.
struct Loop {
  std::vector<Edge> edges;
  std::vector<int> quads, sides;
  std::vector<bool> owned;
};

inline bool is_inside(const Brick& brick, const int* node) { return brick.inside[node[0]][node[1]] >> node[2] & 1; }

// Tell whether the nodes of a box have both signs, its ends included; of a cell or of a quad on its faces.
inline bool is_crossed(const Brick& brick, const int* low, const int* high) {
  const unsigned wanted = (2u << high[2]) - (1u << low[2]);
  unsigned any = 0, all = wanted;
  for (int x = low[0]; x <= high[0]; ++x)
    for (int y = low[1]; y <= high[1]; ++y) {
      any |= brick.inside[x][y];
      all &= brick.inside[x][y];
    }
  return (any & wanted) && all != wanted;
}

// Mark the edges of a brick's own that are crossed, and count them.
void mark_crossed(Brick& brick, const LineShifts& shifts);

// Tells which cells of a brick have finer nodes on a face or on an edge.
class Transitions {
 public:
  explicit Transitions(const LineShifts& shifts);
  bool any() const { return any_; }
  bool at(int x, int y, int z, int size) const;

 private:
  bool any_ = false;
  bool finer_[3][3][3];
};

// Traces the loops of cells, one after the other.
class LoopTracer {
 public:
  LoopTracer() : row_of_(3 * BRICK_NODES, -1) {}

  // Return the loops of three vertices or more on a cell, given its lowest node.
  const std::vector<Loop>& trace(const Brick& brick, const LineShifts& shifts, const int* cell, int size);

 private:
  struct Turn {
    Edge edge;
    int next, quad;  // by its code, until all are known
  };
  struct Crossing {
    Edge edge;
    bool enters;
  };
  void cross_quad(const Brick& brick, const LineShifts& shifts, const int (&corners)[4][3], int quad);

  std::vector<int> row_of_;  // of each edge by its code
  std::vector<Turn> turns_;
  std::vector<Crossing> crossings_;
  std::vector<Loop> loops_;
};

// Cuts loops into triangles, one after the other.
class LoopCutter {
 public:
  // Return three rows of `places`, (n, 3), for each of n - 2 triangles, anticlockwise as seen from outside.
  const std::vector<int>& cut(const Loop& loop, const std::vector<double>& places);

 private:
  void measure(const Loop& loop, const std::vector<double>& places);
  void list(int i, int j);

  int count_ = 0;
  double penalty_ = 0.0;
  std::vector<double> weights_, turns_, costs_;  // (n, n)
  std::vector<int> apexes_, triangles_;
};

// Calls body(x, y, z, size, case) for the cells of a brick without finer nodes that the surface crosses.
template <class Body>
void visit_plain_cells(const Brick& brick, const LineShifts& shifts, const Transitions& transitions, const Body& body) {
  const int size = 1 << shifts.own();
  for (int x = 0; x < BRICK; x += size)
    for (int y = 0; y < BRICK; y += size)
      for (int z = 0; z < BRICK; z += size) {
        if (transitions.at(x, y, z, size)) continue;
        unsigned code = 0;
        for (int corner = 0; corner < 8; ++corner) {
          const int node[3] = {x + (corner & 1) * size, y + (corner >> 1 & 1) * size, z + (corner >> 2) * size};
          code |= static_cast<unsigned>(is_inside(brick, node)) << corner;
        }
        if (code && code != 255) body(x, y, z, size, code);
      }
}

// Calls body(loop) for the loops of all cells with finer nodes.
template <class Body>
void visit_loops(const Brick& brick, const LineShifts& shifts, const Transitions& transitions, LoopTracer& tracer,
                 const Body& body) {
  if (!transitions.any()) return;
  const int size = 1 << shifts.own();
  for (int x = 0; x < BRICK; x += size)
    for (int y = 0; y < BRICK; y += size)
      for (int z = 0; z < BRICK; z += size) {
        if (!transitions.at(x, y, z, size)) continue;
        const int cell[3] = {x, y, z}, end[3] = {x + size, y + size, z + size};
        if (!is_crossed(brick, cell, end)) continue;
        for (const Loop& loop : tracer.trace(brick, shifts, cell, size)) body(loop);
      }
}

}  // namespace hpc
