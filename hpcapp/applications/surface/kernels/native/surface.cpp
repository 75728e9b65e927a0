// From a tile to its mesh: bricks grown across sign changes, and marching cubes over them.
#include <cmath>
#include <cstring>
#include <deque>

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

// A set of bricks with their values, in the order of their keys; those not taken are the rim.
struct Bricks {
  std::vector<int64_t> keys;
  std::vector<const float*> values;
  std::vector<Brick> bricks;
  std::vector<uint8_t> taken;
};

// Return how far along an edge the surface crosses it (see marching_cubes.py).
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

// Return the number of the vertex on an edge of a cell, -1 where the brick of its lower node, which
// owns it, is not there.
int64_t vertex_number(const Bricks& all, const int64_t* neighbours, int edge, int x, int y, int z) {
  // Edges are numbered axis by axis, and within each by the lower corner x + 2y + 4z.
  static constexpr int CORNER[12] = {0, 2, 4, 6, 0, 1, 4, 5, 0, 1, 2, 3};
  const int axis = edge / 4, corner = CORNER[edge];
  x += corner & 1;
  y += corner >> 1 & 1;
  z += corner >> 2;
  const int64_t owner = neighbours[(x >> 3) | (y >> 3) << 1 | (z >> 3) << 2];
  if (owner < 0) return -1;
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
  bool is_whole = true;
  visit_cells(all.bricks[index], [&](int x, int y, int z, unsigned code) {
    const int8_t* edges = table.edges + code * TRIANGLES * 3;
    for (int i = 0; i < 3 * table.count[code]; ++i) {
      *out = vertex_number(all, neighbours, edges[i], x, y, z);
      is_whole = *out++ >= 0 && is_whole;
    }
  });
  if (!is_whole && all.taken[index]) refuse("kinds: a brick that the surface enters is missing");
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

// Leave out the faces at the outer end of the rim, of which a vertex is missing.
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

// What a brick is to a tile (see types/grid.py).
enum Kind : uint8_t { OUT = 0, BESIDE = 1, FOREIGN = 2, OPEN = 3, OWN = 4 };

// The kinds of the bricks within a box of the grid.
struct Kinds {
  Integers first_of;
  Input kinds_of;
  const int64_t* first;
  const uint8_t* kinds;
  int64_t sides[3];

  // Return where a brick stands in the box, -1 outside.
  int64_t find(const Place& place) const {
    int64_t at = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const int64_t local = place[axis] - first[axis];
      if (local < 0 || local >= sides[axis]) return -1;
      at = at * sides[axis] + local;
    }
    return at;
  }

  int64_t count() const { return sides[0] * sides[1] * sides[2]; }
};

// Evaluates a tile's own bricks, the open ones that the surface reaches from them, and their rim.
class Growth {
 public:
  Growth(const Field& field, const Grid& grid, const Kinds& kinds)
      : field_(field), grid_(grid), kinds_(kinds), known_(static_cast<size_t>(kinds.count())) {}

  void run(int threads) {
    std::vector<int64_t> wave = own();
    while (!wave.empty()) {
      const size_t done = keys_.size();
      evaluate(wave, threads);
      wave.clear();
      for (size_t i = done; i < keys_.size(); ++i) take_reached(i, wave);
      std::sort(wave.begin(), wave.end());  // near bricks share vertices: search stays short
    }
    taken_ = keys_.size();
    wave.swap(rim_);
    while (!wave.empty()) {
      std::sort(wave.begin(), wave.end());
      const size_t done = keys_.size();
      evaluate(wave, threads);
      wave.clear();
      for (size_t i = done; i < keys_.size(); ++i) follow_rim(i, wave);
    }
    std::sort(exits_.begin(), exits_.end());
    exits_.erase(std::unique(exits_.begin(), exits_.end()), exits_.end());
  }

  Bricks sorted() {
    std::vector<uint32_t> order(keys_.size());
    for (size_t i = 0; i < order.size(); ++i) order[i] = static_cast<uint32_t>(i);
    std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return keys_[a] < keys_[b]; });
    Bricks all;
    all.keys.reserve(order.size());
    all.values.reserve(order.size());
    all.bricks.reserve(order.size());
    all.taken.reserve(order.size());
    for (uint32_t i : order) {
      all.keys.push_back(keys_[i]);
      all.values.push_back(values_[i]);
      all.bricks.push_back(bricks_[i]);
      all.taken.push_back(i < taken_);
    }
    bricks_ = {};
    return all;
  }

  void drop_values() { chunks_.clear(); }
  Large<int64_t> exits() { return Large<int64_t>(exits_.begin(), exits_.end()); }

 private:
  enum State : uint8_t { UNKNOWN = 0, TAKEN = 1, RIM = 2 };

  // Mark the tile's own bricks as taken and return them, sorted.
  std::vector<int64_t> own() {
    std::vector<int64_t> keys;
    int64_t at = 0;
    for (int64_t x = 0; x < kinds_.sides[0]; ++x)
      for (int64_t y = 0; y < kinds_.sides[1]; ++y)
        for (int64_t z = 0; z < kinds_.sides[2]; ++z, ++at) {
          if (kinds_.kinds[at] != OWN) continue;
          known_[static_cast<size_t>(at)] = TAKEN;
          keys.push_back(pack({x + kinds_.first[0], y + kinds_.first[1], z + kinds_.first[2]}));
        }
    return keys;
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

  // Call body(place) for the neighbours behind the crossed faces of a brick.
  template <class Body>
  void visit_reached(size_t index, const Body& body) const {
    for (int axis = 0; axis < 3; ++axis)
      for (int high = 0; high < 2; ++high) {
        Place place = unpack(keys_[index]);
        place[axis] += high ? 1 : -1;
        if (place[axis] < 0 || place[axis] >= grid_.bricks[axis]) continue;
        if (face_crossed(bricks_[index], axis, high)) body(place);
      }
  }

  // Take what the surface reaches from a taken brick, as far as it may be taken.
  void take_reached(size_t index, std::vector<int64_t>& next) {
    visit_reached(index, [&](const Place& place) {
      const int64_t at = kinds_.find(place);
      const uint8_t kind = at < 0 ? uint8_t{OUT} : kinds_.kinds[at];
      if (kind == OUT || kind == BESIDE) exits_.push_back(pack(place));
      if (kind == OUT || known_[static_cast<size_t>(at)]) return;
      const bool may_be_taken = kind == OPEN || kind == OWN;
      known_[static_cast<size_t>(at)] = may_be_taken ? TAKEN : RIM;
      (may_be_taken ? next : rim_).push_back(pack(place));
    });
  }

  // Follow the surface through the rim, as far as it touches what is taken.
  void follow_rim(size_t index, std::vector<int64_t>& next) {
    visit_reached(index, [&](const Place& place) {
      const int64_t at = kinds_.find(place);
      if (at < 0 || kinds_.kinds[at] == OUT || known_[static_cast<size_t>(at)] || !touches_taken(place)) return;
      known_[static_cast<size_t>(at)] = RIM;
      next.push_back(pack(place));
    });
  }

  bool touches_taken(const Place& place) const {
    for (int64_t x = -1; x <= 1; ++x)
      for (int64_t y = -1; y <= 1; ++y)
        for (int64_t z = -1; z <= 1; ++z) {
          const int64_t at = kinds_.find({place[0] + x, place[1] + y, place[2] + z});
          if (at >= 0 && known_[static_cast<size_t>(at)] == TAKEN) return true;
        }
    return false;
  }

  const Field& field_;
  const Grid& grid_;
  const Kinds& kinds_;
  std::vector<uint8_t> known_;
  std::vector<int64_t> keys_, rim_, exits_;
  size_t taken_ = 0;
  std::vector<const float*> values_;
  std::deque<Brick> bricks_;  // which grows without a second copy
  std::vector<Buffer<float>> chunks_;
};

nb::object give_mesh(Bricks& all, Extracted&& mesh, Large<int64_t>&& exits) {
  const size_t count = all.keys.size();
  Large<int64_t> keys(all.keys.begin(), all.keys.end());
  auto taken = make_buffer<bool>(static_cast<int64_t>(count));
  auto vertices = make_buffer<int32_t>(static_cast<int64_t>(count)), faces = make_buffer<int32_t>(static_cast<int64_t>(count));
  for (size_t i = 0; i < count; ++i) {
    taken[i] = all.taken[i];
    vertices[i] = all.bricks[i].vertices;
    faces[i] = all.bricks[i].faces;
  }
  const size_t vertex_count = static_cast<size_t>(mesh.vertex_count), face_count = static_cast<size_t>(mesh.face_count);
  return python_object("types.mesh", "BrickMesh")(
      give(std::move(keys)), give(std::move(taken), {count}), give(std::move(vertices), {count}),
      give(std::move(faces), {count}), give(std::move(mesh.vertices), {vertex_count, 3}),
      give(std::move(mesh.faces), {face_count, 3}), give(std::move(exits)));
}

Kinds take_kinds(nb::handle given, const Grid& grid) {
  Kinds kinds{field_of<Integers>(given, "first"), field_of<Bytes>(given, "kinds"), nullptr, nullptr, {}};
  kinds.first = check<int64_t>(kinds.first_of, "first", {3});
  kinds.kinds = check<uint8_t>(kinds.kinds_of, "kinds", {ANY, ANY, ANY});
  for (int axis = 0; axis < 3; ++axis) {
    kinds.sides[axis] = static_cast<int64_t>(kinds.kinds_of.shape(static_cast<size_t>(axis)));
    if (kinds.first[axis] < 0 || kinds.first[axis] > grid.bricks[axis] - kinds.sides[axis])
      refuse("kinds: a brick lies off the grid");
  }
  return kinds;
}

nb::object grow_surface(nb::handle field_given, nb::handle grid_given, nb::handle kinds_given, int64_t threads) {
  const Grid grid = take_grid(grid_given);
  const Field field = take_field(field_given, grid);
  const Kinds kinds = take_kinds(kinds_given, grid);
  const Input triangles = nb::cast<Input>(python_object("kernels.case_table", "case_triangles")());
  const CaseTable table(triangles);
  const int workers = check_threads(threads);
  Extracted mesh;
  Bricks all;
  Large<int64_t> exits;
  {
    nb::gil_scoped_release unlocked;
    give_back_rest();  // the fits are over, and the values of all bricks are to come
    Growth growth(field, grid, kinds);
    growth.run(workers);
    exits = growth.exits();
    all = growth.sorted();
    mesh = place_all(grid, all, table, workers);
    growth.drop_values();
    assemble_all(all, table, workers, mesh);
    drop_torn(all, mesh);
  }
  return give_mesh(all, std::move(mesh), std::move(exits));
}

}  // namespace

void bind_surface(nb::module_& module) {
  module.def("grow_surface", &grow_surface, "field"_a, "grid"_a, "kinds"_a, "threads"_a = 1);
}

}  // namespace hpc
