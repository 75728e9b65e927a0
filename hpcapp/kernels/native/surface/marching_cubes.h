// Marching cubes over bricks, welded by edge numbers (see marching_cubes.py).
#pragma once

#include <cstdint>
#include <vector>

#include "brick_signs.h"
#include "constants.h"
#include "field/strides.h"

namespace hpc {

constexpr int CASES = 256, TRIANGLES = constants::case_table::MAX_TRIANGLES;

// The triangles of every case, as numbers of edges (see case_table.py).
struct CaseTable {
  const int8_t* edges;
  int count[CASES];

  explicit CaseTable(const Input& table) : edges(check<int8_t>(table, "table", {CASES, TRIANGLES, 3})) {
    for (int code = 0; code < CASES; ++code) {
      count[code] = 0;
      while (count[code] < TRIANGLES && edges[(code * TRIANGLES + count[code]) * 3] >= 0) ++count[code];
    }
  }
};

// A set of bricks with the values of their nodes, in the order of their keys; those not taken are the rim.
struct Bricks {
  std::vector<int64_t> keys;
  std::vector<const float*> values;
  std::vector<Brick> bricks;
  std::vector<uint8_t> taken;
  std::vector<LineShifts> shifts;  // none where all strides are 1

  const LineShifts& shifts_of(size_t index) const {
    static const LineShifts none;
    return shifts.empty() ? none : shifts[index];
  }
};

struct Extracted {
  Buffer<double> vertices;
  Buffer<int64_t> faces;
  int64_t vertex_count = 0, face_count = 0;
};

// Number the vertices and faces of all bricks and place the vertices: the last that values are for.
Extracted place_all(const Grid& grid, Bricks& all, const CaseTable& table, int threads);

void assemble_all(const Bricks& all, const CaseTable& table, int threads, Extracted& mesh);

// Leave out the faces at the outer end of the rim, of which a vertex is missing.
void drop_torn(Bricks& all, Extracted& mesh);

}  // namespace hpc
