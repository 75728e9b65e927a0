#include "marching_cubes.h"

#include <cmath>

#include "constants.h"
#include "threads.h"
#include "transitions.h"

namespace hpc {
namespace {

using constants::marching_cubes::NEAREST;

void count_brick(Brick& brick, const CaseTable& table) {
  brick.vertices = brick.faces = 0;
  for (int axis = 0; axis < 3; ++axis)
    for (int x = 0; x < BRICK; ++x)
      for (int y = 0; y < BRICK; ++y) {
        const unsigned row = brick.inside[x][y];
        const unsigned next = axis == 0 ? brick.inside[x + 1][y] : axis == 1 ? brick.inside[x][y + 1] : row >> 1;
        const unsigned crossed = (row ^ next) & 0xFF;
        brick.crossed[axis][x][y] = static_cast<uint8_t>(crossed);
        brick.before[axis][x][y] = static_cast<uint16_t>(brick.vertices);
        brick.vertices += count_bits(crossed);
      }
  visit_cells(brick, [&](int, int, int, unsigned code) { brick.faces += table.count[code]; });
}

// The same where nodes are farther apart.
void count_brick(Brick& brick, const LineShifts& shifts, const CaseTable& table, LoopTracer& tracer) {
  mark_crossed(brick, shifts);
  brick.faces = 0;
  const Transitions transitions(shifts);
  visit_plain_cells(brick, shifts, transitions,
                    [&](int, int, int, int, unsigned code) { brick.faces += table.count[code]; });
  visit_loops(brick, shifts, transitions, tracer,
              [&](const Loop& loop) { brick.faces += static_cast<int>(loop.edges.size()) - 2; });
}

// Return how far along an edge the surface crosses it (see marching_cubes.py). Its line has `last` edges in
// the brick, of which it is the one at `place`.
double cross_edge(const float* values, int node, int stride, int place, int last) {
  const double first = values[node], rise = values[node + stride] - first;
  double bend = 0.0;
  if (last >= 3) {
    const float* four = values + node + (std::min(std::max(place - 1, 0), last - 3) - place) * stride;
    double rises[3];
    for (int i = 0; i < 3; ++i) rises[i] = static_cast<double>(four[(i + 1) * stride]) - four[i * stride];
    const double lower = rises[1] - rises[0], upper = rises[2] - rises[1];
    const double smaller = std::abs(lower) < std::abs(upper) ? lower : upper;
    const double most = std::abs(rise);
    bend = lower * upper > 0.0 ? 0.5 * std::min(std::max(smaller, -most), most) : 0.0;
  }
  const double slope = rise - bend;
  const double root = std::sqrt(slope * slope - 4.0 * bend * first);
  return std::min(std::max(2.0 * std::abs(first) / (root + std::abs(slope)), NEAREST), 1.0 - NEAREST);
}

void place_vertices(const Grid& grid, const Place& place, const Brick& brick, const LineShifts& shifts,
                    const float* values, double* out) {
  // Values are of the lattice of all nodes.
  const int finest = shifts.finest(), side = shifts.cells() + 1, strides[3] = {side * side, side, 1};
  const bool is_fine = shifts.are_zero();
  for (int axis = 0; axis < 3; ++axis)
    for (int x = 0; x < BRICK; ++x)
      for (int y = 0; y < BRICK; ++y)
        for (int z = 0; brick.crossed[axis][x][y] >> z; ++z) {
          if (!(brick.crossed[axis][x][y] >> z & 1)) continue;
          const int node = ((x >> finest) * side + (y >> finest)) * side + (z >> finest);
          const int local[3] = {x, y, z}, shift = is_fine ? 0 : shifts.along(axis, local);
          const int stride = strides[axis] << (shift - finest);
          const double along = (1 << shift) * cross_edge(values, node, stride, local[axis] >> shift, BRICK >> shift);
          for (int a = 0; a < 3; ++a) {
            double coordinate = static_cast<double>(BRICK * place[a] + local[a]);
            if (a == axis) coordinate += along;
            *out++ = grid.origin[a] + coordinate * grid.step;
          }
        }
}

// Return the number of the vertex on an edge, given its lower node, -1 where the brick of that node,
// which owns it, is not there.
int64_t vertex_number(const Bricks& all, const int64_t* neighbours, int axis, int x, int y, int z) {
  const int64_t owner = neighbours[(x >> 3) | (y >> 3) << 1 | (z >> 3) << 2];
  if (owner < 0) return -1;
  const Brick& brick = all.bricks[static_cast<size_t>(owner)];
  x &= 7, y &= 7, z &= 7;
  const unsigned below = brick.crossed[axis][x][y] & ((1u << z) - 1);
  return brick.first_vertex + brick.before[axis][x][y] + count_bits(below);
}

// Assembles the faces of bricks, one after the other.
class Assembler {
 public:
  Assembler(const Bricks& all, const CaseTable& table, const double* vertices)
      : all_(all), table_(table), vertices_(vertices),
        fingers_(8, Finger(all.keys.data(), static_cast<int64_t>(all.keys.size()))) {}

  void assemble(size_t index, int64_t* out) {
    for (int octant = 0; octant < 8; ++octant) {
      int64_t key = all_.keys[index];
      for (int axis = 0; axis < 3; ++axis) key += (octant >> axis & 1) * STRIDES[axis];
      neighbours_[octant] = fingers_[octant].find(key);
    }
    out_ = out;
    is_whole_ = true;
    const Brick& brick = all_.bricks[index];
    const LineShifts& shifts = all_.shifts_of(index);
    if (shifts.are_zero()) {
      visit_cells(brick, [&](int x, int y, int z, unsigned code) { add_cell(x, y, z, 1, code); });
    } else {
      const Transitions transitions(shifts);
      visit_plain_cells(brick, shifts, transitions,
                        [&](int x, int y, int z, int size, unsigned code) { add_cell(x, y, z, size, code); });
      visit_loops(brick, shifts, transitions, tracer_, [&](const Loop& loop) { add_loop(loop); });
    }
    if (!is_whole_ && all_.taken[index]) refuse("kinds: a brick that the surface enters is missing");
  }

 private:
  void add_cell(int x, int y, int z, int size, unsigned code) {
    // Edges are numbered axis by axis, and within each by the lower corner x + 2y + 4z.
    static constexpr int CORNER[12] = {0, 2, 4, 6, 0, 1, 4, 5, 0, 1, 2, 3};
    const int8_t* edges = table_.edges + code * TRIANGLES * 3;
    for (int i = 0; i < 3 * table_.count[code]; ++i) {
      const int corner = CORNER[edges[i]];
      *out_ = vertex_number(all_, neighbours_, edges[i] / 4, x + (corner & 1) * size, y + (corner >> 1 & 1) * size,
                            z + (corner >> 2) * size);
      is_whole_ = *out_++ >= 0 && is_whole_;
    }
  }

  // A loop of which a vertex is missing has no faces.
  void add_loop(const Loop& loop) {
    numbers_.clear();
    places_.clear();
    for (const Edge& edge : loop.edges) {
      const int64_t number = vertex_number(all_, neighbours_, edge.axis, edge.node[0], edge.node[1], edge.node[2]);
      if (number < 0) {
        out_ = std::fill_n(out_, 3 * (loop.edges.size() - 2), int64_t{-1});
        is_whole_ = false;
        return;
      }
      numbers_.push_back(number);
      places_.insert(places_.end(), vertices_ + 3 * number, vertices_ + 3 * number + 3);
    }
    for (int row : cutter_.cut(loop, places_)) *out_++ = numbers_[static_cast<size_t>(row)];
  }

  const Bricks& all_;
  const CaseTable& table_;
  const double* vertices_;
  std::vector<Finger> fingers_;
  int64_t neighbours_[8];  // of the brick, and those above it
  LoopTracer tracer_;
  LoopCutter cutter_;
  std::vector<int64_t> numbers_;
  std::vector<double> places_;
  int64_t* out_ = nullptr;
  bool is_whole_ = true;
};

}  // namespace

Extracted place_all(const Grid& grid, Bricks& all, const CaseTable& table, int threads) {
  const int64_t count = static_cast<int64_t>(all.keys.size());
  run_ranges(count, threads, [&](int64_t start, int64_t stop) {
    LoopTracer tracer;
    for (int64_t i = start; i < stop; ++i) {
      const LineShifts& shifts = all.shifts_of(static_cast<size_t>(i));
      if (shifts.are_zero()) {
        count_brick(all.bricks[i], table);
      } else {
        count_brick(all.bricks[i], shifts, table, tracer);
      }
    }
  });
  Extracted mesh;
  for (Brick& brick : all.bricks) {
    brick.first_vertex = mesh.vertex_count;
    brick.first_face = mesh.face_count;
    mesh.vertex_count += brick.vertices;
    mesh.face_count += brick.faces;
  }
  mesh.vertices = make_buffer<double>(3 * mesh.vertex_count);
  run_ranges(count, threads, [&](int64_t start, int64_t stop) {
    for (int64_t i = start; i < stop; ++i) {
      const Brick& brick = all.bricks[i];
      if (brick.vertices)
        place_vertices(grid, unpack(all.keys[i]), brick, all.shifts_of(static_cast<size_t>(i)), all.values[i],
                       mesh.vertices.get() + 3 * brick.first_vertex);
    }
  });
  return mesh;
}

void assemble_all(const Bricks& all, const CaseTable& table, int threads, Extracted& mesh) {
  const int64_t count = static_cast<int64_t>(all.keys.size());
  mesh.faces = make_buffer<int64_t>(3 * mesh.face_count);
  run_ranges(count, threads, [&](int64_t start, int64_t stop) {
    Assembler assembler(all, table, mesh.vertices.get());
    for (int64_t i = start; i < stop; ++i) {
      const Brick& brick = all.bricks[i];
      if (brick.faces) assembler.assemble(static_cast<size_t>(i), mesh.faces.get() + 3 * brick.first_face);
    }
  });
}

void drop_torn(Bricks& all, Extracted& mesh) {
  int64_t* faces = mesh.faces.get();
  int64_t kept = 0;
  for (Brick& brick : all.bricks) {
    const int64_t start = kept;
    for (int64_t f = brick.first_face; f < brick.first_face + brick.faces; ++f) {
      const int64_t* face = faces + 3 * f;
      if (face[0] < 0 || face[1] < 0 || face[2] < 0) continue;
      if (f != kept) std::copy(face, face + 3, faces + 3 * kept);
      ++kept;
    }
    brick.first_face = start;
    brick.faces = static_cast<int>(kept - start);
  }
  mesh.face_count = kept;
}

}  // namespace hpc
