// From seeds to a mesh: bricks grown across sign changes, and marching cubes over them.
#include <cmath>
#include <cstring>

#include "brick_signs.h"
#include "families.h"
#include "field.h"
#include "threads.h"

namespace hpc {
namespace {

constexpr double NEAREST = 0.002;  // vertices keep this share of an edge from its ends
constexpr int CASES = 256, TRIANGLES = 5;

// The triangles of every case, as numbers of edges (see case_table.py).
struct CaseTable {
  const int8_t* edges;
  int count[CASES];

  explicit CaseTable(const Input& table) : edges(check<int8_t>(table, "table", {CASES, TRIANGLES, 3})) {
    for (int code = 0; code < CASES; ++code) {
      count[code] = 0;
      while (count[code] < TRIANGLES && edges[(code * TRIANGLES + count[code]) * 3] >= 0) ++count[code];
      for (int i = 0; i < 3 * count[code]; ++i)
        if (edges[code * TRIANGLES * 3 + i] < 0 || edges[code * TRIANGLES * 3 + i] >= 12)
          refuse("table: expected edges 0 to 11");
    }
  }
};

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

// A set of bricks with their values, in the order of their keys.
struct Bricks {
  std::vector<int64_t> keys;
  std::vector<const float*> values;
  std::vector<Brick> bricks;
};

// Return how far along an edge the surface crosses it (see extraction.py).
double cross_edge(const float* values, int node, int stride, int place) {
  const float* four = values + node + (std::min(std::max(place - 1, 0), NODES - 4) - place) * stride;
  double rises[3];
  for (int i = 0; i < 3; ++i) rises[i] = static_cast<double>(four[(i + 1) * stride]) - four[i * stride];
  const double first = values[node], rise = values[node + stride] - first;
  const double lower = rises[1] - rises[0], upper = rises[2] - rises[1];
  const double smaller = std::abs(lower) < std::abs(upper) ? lower : upper;
  const double most = std::abs(rise);
  const double bend = lower * upper > 0.0 ? 0.5 * std::min(std::max(smaller, -most), most) : 0.0;
  const double slope = rise - bend;
  const double root = std::sqrt(slope * slope - 4.0 * bend * first);
  return std::min(std::max(2.0 * std::abs(first) / (root + std::abs(slope)), NEAREST), 1.0 - NEAREST);
}

void place_vertices(const Grid& grid, const Place& place, const Brick& brick, const float* values, double* out) {
  const int strides[3] = {NODES * NODES, NODES, 1};
  for (int axis = 0; axis < 3; ++axis)
    for (int x = 0; x < BRICK; ++x)
      for (int y = 0; y < BRICK; ++y)
        for (int z = 0; brick.crossed[axis][x][y] >> z; ++z) {
          if (!(brick.crossed[axis][x][y] >> z & 1)) continue;
          const int node = (x * NODES + y) * NODES + z;
          const int local[3] = {x, y, z};
          const double along = cross_edge(values, node, strides[axis], local[axis]);
          for (int a = 0; a < 3; ++a) {
            double coordinate = static_cast<double>(BRICK * place[a] + local[a]);
            if (a == axis) coordinate += along;
            *out++ = grid.origin[a] + coordinate * grid.step;
          }
        }
}

// Return the number of the vertex on an edge of a cell; the brick of its lower node owns it.
int64_t vertex_number(const Bricks& all, const int64_t* neighbours, int edge, int x, int y, int z) {
  // Edges are numbered axis by axis, and within each by the lower corner x + 2y + 4z.
  static constexpr int CORNER[12] = {0, 2, 4, 6, 0, 1, 4, 5, 0, 1, 2, 3};
  const int axis = edge / 4, corner = CORNER[edge];
  x += corner & 1;
  y += corner >> 1 & 1;
  z += corner >> 2;
  const int64_t owner = neighbours[(x >> 3) | (y >> 3) << 1 | (z >> 3) << 2];
  if (owner < 0) refuse("places: a brick that the surface enters is missing");
  const Brick& brick = all.bricks[static_cast<size_t>(owner)];
  x &= 7, y &= 7, z &= 7;
  const unsigned below = brick.crossed[axis][x][y] & ((1u << z) - 1);
  return brick.first_vertex + brick.before[axis][x][y] + count_bits(below);
}

void assemble_faces(const Bricks& all, size_t index, Finger* fingers, const CaseTable& table, int64_t* out) {
  int64_t neighbours[8];
  for (int octant = 0; octant < 8; ++octant) {
    int64_t key = all.keys[index];
    for (int axis = 0; axis < 3; ++axis) key += (octant >> axis & 1) * STRIDES[axis];
    neighbours[octant] = fingers[octant].find(key);
  }
  visit_cells(all.bricks[index], [&](int x, int y, int z, unsigned code) {
    const int8_t* edges = table.edges + code * TRIANGLES * 3;
    for (int i = 0; i < 3 * table.count[code]; ++i)
      *out++ = vertex_number(all, neighbours, edges[i], x, y, z);
  });
}

struct Extracted {
  Buffer<double> vertices;
  Buffer<int64_t> faces;
  int64_t vertex_count = 0, face_count = 0;
};

// Number the vertices and faces of all bricks and place the vertices: the last that values are for.
Extracted place_all(const Grid& grid, Bricks& all, const CaseTable& table, int threads) {
  const int64_t count = static_cast<int64_t>(all.keys.size());
  run_ranges(count, threads, [&](int64_t start, int64_t stop) {
    for (int64_t i = start; i < stop; ++i) count_brick(all.bricks[i], table);
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
        place_vertices(grid, unpack(all.keys[i]), brick, all.values[i], mesh.vertices.get() + 3 * brick.first_vertex);
    }
  });
  return mesh;
}

void assemble_all(const Bricks& all, const CaseTable& table, int threads, Extracted& mesh) {
  const int64_t count = static_cast<int64_t>(all.keys.size());
  mesh.faces = make_buffer<int64_t>(3 * mesh.face_count);
  run_ranges(count, threads, [&](int64_t start, int64_t stop) {
    std::vector<Finger> fingers(8, Finger(all.keys.data(), count));
    for (int64_t i = start; i < stop; ++i) {
      const Brick& brick = all.bricks[i];
      if (brick.faces)
        assemble_faces(all, static_cast<size_t>(i), fingers.data(), table, mesh.faces.get() + 3 * brick.first_face);
    }
  });
}

// Evaluates seeds, and every brick behind a face with a sign change, until none is left.
class Growth {
 public:
  Growth(const Field& field, const Grid& grid) : field_(field), grid_(grid), known_(static_cast<size_t>(grid.bricks[0] * grid.bricks[1] * grid.bricks[2])) {}

  void run(std::vector<int64_t> wave, int threads) {
    for (int64_t key : wave) mark(unpack(key));
    while (!wave.empty()) {
      evaluate(wave, threads);
      std::vector<int64_t> next;
      for (size_t i = keys_.size() - wave.size(); i < keys_.size(); ++i) reach(i, next);
      std::sort(next.begin(), next.end());  // near bricks share vertices: search stays short
      wave.swap(next);
    }
  }

  Bricks sorted() {
    std::vector<uint32_t> order(keys_.size());
    for (size_t i = 0; i < order.size(); ++i) order[i] = static_cast<uint32_t>(i);
    std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return keys_[a] < keys_[b]; });
    Bricks all;
    for (uint32_t i : order) {
      all.keys.push_back(keys_[i]);
      all.values.push_back(values_[i]);
      all.bricks.push_back(bricks_[i]);
    }
    bricks_ = {};
    return all;
  }

  void drop_values() { chunks_.clear(); }

 private:
  // Mark a brick as known; return whether it was not.
  bool mark(const Place& p) {
    const size_t at = static_cast<size_t>((p[0] * grid_.bricks[1] + p[1]) * grid_.bricks[2] + p[2]);
    if (known_[at]) return false;
    known_[at] = true;
    return true;
  }

  void evaluate(const std::vector<int64_t>& wave, int threads) {
    const size_t done = keys_.size();
    const int64_t count = static_cast<int64_t>(wave.size());
    chunks_.push_back(make_buffer<float>(count * BRICK_NODES));
    float* chunk = chunks_.back().get();
    keys_.insert(keys_.end(), wave.begin(), wave.end());
    bricks_.resize(keys_.size());
    for (int64_t i = 0; i < count; ++i) values_.push_back(chunk + i * BRICK_NODES);
    run_ranges(count, threads, [&](int64_t start, int64_t stop) {
      BrickEvaluator evaluator(field_, grid_);
      for (int64_t i = start; i < stop; ++i) {
        evaluator.evaluate(unpack(wave[i]), chunk + i * BRICK_NODES);
        mark_inside(chunk + i * BRICK_NODES, bricks_[done + i]);
      }
    });
  }

  // Append the unknown neighbours behind the crossed faces of a brick.
  void reach(size_t index, std::vector<int64_t>& next) {
    for (int axis = 0; axis < 3; ++axis)
      for (int high = 0; high < 2; ++high) {
        Place place = unpack(keys_[index]);
        place[axis] += high ? 1 : -1;
        if (place[axis] < 0 || place[axis] >= grid_.bricks[axis]) continue;
        if (face_crossed(bricks_[index], axis, high) && mark(place)) next.push_back(pack(place));
      }
  }

  const Field& field_;
  const Grid& grid_;
  std::vector<bool> known_;
  std::vector<int64_t> keys_;
  std::vector<const float*> values_;
  std::vector<Brick> bricks_;
  std::vector<Buffer<float>> chunks_;
};

nb::tuple give_mesh(Extracted&& mesh) {
  const size_t vertices = static_cast<size_t>(mesh.vertex_count), faces = static_cast<size_t>(mesh.face_count);
  return nb::make_tuple(give(std::move(mesh.vertices), {vertices, 3}), give(std::move(mesh.faces), {faces, 3}));
}

void check_places(const int64_t* keys, int64_t count, const Grid& grid, const char* name) {
  for (int64_t i = 0; i < count; ++i) {
    const Place place = unpack(keys[i]);
    for (int axis = 0; axis < 3; ++axis)
      if (place[axis] < 0 || place[axis] >= grid.bricks[axis]) refuse(std::string(name) + ": a brick lies off the grid");
  }
}

nb::tuple grow_surface(nb::tuple arguments, Input origin, double step, Input sides, Input seeds_of, Input table_of,
                       int64_t threads) {
  const Grid grid = take_grid(origin, step, sides);
  const Field field = take_field(arguments, grid);
  const int64_t* seeds = check_keys(seeds_of, "seeds");
  const int64_t count = rows_of(seeds_of);
  check_places(seeds, count, grid, "seeds");
  const CaseTable table(table_of);
  const int workers = check_threads(threads);
  Extracted mesh;
  {
    nb::gil_scoped_release unlocked;
    Growth growth(field, grid);
    growth.run(std::vector<int64_t>(seeds, seeds + count), workers);
    Bricks all = growth.sorted();
    mesh = place_all(grid, all, table, workers);
    growth.drop_values();
    assemble_all(all, table, workers, mesh);
  }
  return give_mesh(std::move(mesh));
}

nb::tuple extract_surface(Input origin, double step, Input sides, Input keys_of, Input values_of, Input table_of,
                          int64_t threads) {
  const Grid grid = take_grid(origin, step, sides);
  const int64_t* keys = check_keys(keys_of, "keys");
  const int64_t count = rows_of(keys_of);
  check_places(keys, count, grid, "keys");
  const float* values = check<float>(values_of, "values", {count, NODES, NODES, NODES});
  for (int64_t i = 0; i < count * BRICK_NODES; ++i)
    if (!std::isfinite(values[i])) refuse("values: expected finite numbers");
  const CaseTable table(table_of);
  const int workers = check_threads(threads);
  Extracted mesh;
  {
    nb::gil_scoped_release unlocked;
    Bricks all{std::vector<int64_t>(keys, keys + count), {}, std::vector<Brick>(static_cast<size_t>(count))};
    for (int64_t i = 0; i < count; ++i) {
      all.values.push_back(values + i * BRICK_NODES);
      mark_inside(all.values.back(), all.bricks[i]);
    }
    mesh = place_all(grid, all, table, workers);
    assemble_all(all, table, workers, mesh);
  }
  return give_mesh(std::move(mesh));
}

}  // namespace

void bind_surface(nb::module_& module) {
  module.def("grow_surface", &grow_surface);
  module.def("extract_surface", &extract_surface);
}

}  // namespace hpc
