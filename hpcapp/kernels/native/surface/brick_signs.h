// The signs of a brick's nodes as bits: what growth and extraction ask of them.
#pragma once

#include <cstdint>

#include "field/field.h"

namespace hpc {

// A brick's signs, one bit per node along z, and where its vertices begin.
struct Brick {
  uint16_t inside[NODES][NODES];
  uint8_t crossed[3][BRICK][BRICK];   // one bit per edge along z
  uint16_t before[3][BRICK][BRICK];   // the brick's vertices before these eight edges
  int64_t first_vertex = 0, first_face = 0;
  int vertices = 0, faces = 0;
};

inline int count_bits(unsigned byte) {
  byte = byte - (byte >> 1 & 0x55u);
  byte = (byte & 0x33u) + (byte >> 2 & 0x33u);
  return static_cast<int>((byte + (byte >> 4)) & 0x0Fu);
}

inline void mark_inside(const float* values, Brick& brick) {
  for (int x = 0; x < NODES; ++x)
    for (int y = 0; y < NODES; ++y) {
      unsigned row = 0;
      for (int z = 0; z < NODES; ++z) row |= static_cast<unsigned>(*values++ < 0.0f) << z;
      brick.inside[x][y] = static_cast<uint16_t>(row);
    }
}

// The same where some places have no node: they are inside where the next node below them is. Values are
// of the lattice of all nodes.
inline void mark_inside(const float* values, const LineShifts& shifts, Brick& brick) {
  const int every = 1 << shifts.finest();
  uint16_t nodes[NODES][NODES];
  for (int x = 0; x < NODES; x += every)
    for (int y = 0; y < NODES; y += every) {
      unsigned row = 0;
      for (int z = 0; z < NODES; z += every) row |= static_cast<unsigned>(*values++ < 0.0f) << z;
      nodes[x][y] = static_cast<uint16_t>(row);
    }
  constexpr unsigned MULTIPLES[MOST_SHIFT + 1] = {0x1FF, 0x155, 0x111, 0x101};
  for (int x = 0; x < NODES; ++x)
    for (int y = 0; y < NODES; ++y) {
      const uint8_t* lines = shifts.at[end_of(x)][end_of(y)];
      const auto below = [&](int shift) -> unsigned { return nodes[x >> shift << shift][y >> shift << shift]; };
      unsigned row = below(lines[1]) & MULTIPLES[lines[1]];
      for (int shift = 0; shift < lines[1]; ++shift) row |= row << (1 << shift);
      brick.inside[x][y] = static_cast<uint16_t>((below(lines[0]) & 1u) | (row & 0xFE) | (below(lines[2]) & 0x100u));
    }
}

// Tell whether the sign changes on a face: axis 0 to 2, at its low or its high end.
inline bool face_crossed(const Brick& brick, int axis, bool high) {
  unsigned any = 0, all = 0x1FF;
  const int at = high ? BRICK : 0;
  for (int i = 0; i < NODES; ++i)
    for (int j = 0; j < (axis == 2 ? NODES : 1); ++j) {
      unsigned row = axis == 0 ? brick.inside[at][i] : axis == 1 ? brick.inside[i][at] : brick.inside[i][j];
      if (axis == 2) row = (row >> at & 1) ? 0x1FF : 0;
      any |= row;
      all &= row;
    }
  return any && all != 0x1FF;
}

// Calls body(x, y, z, case) for every cell that the surface crosses.
template <class Body>
void visit_cells(const Brick& brick, const Body& body) {
  for (int x = 0; x < BRICK; ++x)
    for (int y = 0; y < BRICK; ++y) {
      const unsigned rows[4] = {brick.inside[x][y], brick.inside[x + 1][y], brick.inside[x][y + 1],
                                brick.inside[x + 1][y + 1]};
      const unsigned some = rows[0] | rows[1] | rows[2] | rows[3];
      const unsigned every = rows[0] & rows[1] & rows[2] & rows[3];
      const unsigned active = (some | some >> 1) & ~(every & every >> 1) & 0xFF;
      for (int z = 0; active >> z; ++z) {
        if (!(active >> z & 1)) continue;
        unsigned code = 0;
        for (int corner = 0; corner < 8; ++corner) code |= (rows[corner & 3] >> (z + (corner >> 2)) & 1) << corner;
        body(x, y, z, code);
      }
    }
}

}  // namespace hpc
