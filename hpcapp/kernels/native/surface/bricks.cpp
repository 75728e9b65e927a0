// The bricks that the surface passes through: seeded at the points, grown across sign changes (see bricks.py).
#include <deque>

#include "arrays.h"
#include "constants.h"
#include "field/field.h"
#include "lattice/points.h"
#include "marching_cubes.h"
#include "seeds.h"
#include "threads.h"

namespace hpc {
namespace {

using constants::grid::BESIDE, constants::grid::OPEN, constants::grid::OUT, constants::grid::OWN;

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
    if (!wave.empty()) {
      depth_.assign(known_.size(), BRICK);
      for (size_t i = 0; i < taken_; ++i) approach(unpack(keys_[i]), 0, wave);
    }
    while (!wave.empty()) {
      std::sort(wave.begin(), wave.end());
      const size_t done = keys_.size();
      evaluate(wave, threads);
      wave.clear();
      for (size_t i = done; i < keys_.size(); ++i) follow_rim(i, wave);
      for (size_t i = done; i < keys_.size(); ++i) lead_on(unpack(keys_[i]), wave);
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
      if (grid_.strides.differ) all.shifts.push_back(shifts_[i]);
    }
    bricks_ = {};
    return all;
  }

  void drop_values() { chunks_.clear(); }
  Large<int64_t> exits() { return Large<int64_t>(exits_.begin(), exits_.end()); }

 private:
  enum State : uint8_t { UNKNOWN = 0, TAKEN = 1, RIM = 2, REACHED = 3 };

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
    keys_.insert(keys_.end(), wave.begin(), wave.end());
    bricks_.resize(keys_.size());
    make_room(wave, threads);
    run_ranges(count, threads, [&](int64_t start, int64_t stop) {
      BrickEvaluator evaluator(field_, grid_);
      for (int64_t i = start; i < stop; ++i) {
        const size_t at = done + static_cast<size_t>(i);
        const int every = grid_.strides.differ ? 1 << shifts_[at].finest() : 1;
        evaluator.evaluate(unpack(wave[i]), every, values_[at]);
        if (grid_.strides.differ) {
          mark_inside(values_[at], shifts_[at], bricks_[at]);
        } else {
          mark_inside(values_[at], bricks_[at]);
        }
      }
    });
  }

  // Make room for the values of some bricks: of the lattice of all nodes of each.
  void make_room(const std::vector<int64_t>& wave, int threads) {
    const size_t done = values_.size();
    const int64_t count = static_cast<int64_t>(wave.size());
    values_.resize(keys_.size());
    if (!grid_.strides.differ) {
      chunks_.push_back(make_buffer<float>(count * BRICK_NODES));
      for (int64_t i = 0; i < count; ++i)
        values_[done + static_cast<size_t>(i)] = chunks_.back().get() + i * BRICK_NODES;
      return;
    }
    shifts_.resize(keys_.size());
    run_ranges(count, threads, [&](int64_t start, int64_t stop) {
      for (int64_t i = start; i < stop; ++i)
        shifts_[done + static_cast<size_t>(i)] = line_shifts(grid_, unpack(wave[i]));
    });
    std::vector<int64_t> starts(1, 0);
    for (size_t i = done; i < keys_.size(); ++i) {
      const int64_t side = shifts_[i].cells() + 1;
      starts.push_back(starts.back() + side * side * side);
    }
    chunks_.push_back(make_buffer<float>(starts.back()));
    for (size_t i = done; i < keys_.size(); ++i) values_[i] = chunks_.back().get() + starts[i - done];
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

  // Follow the surface through the rim; what is too far from what is taken waits for a shorter way.
  void follow_rim(size_t index, std::vector<int64_t>& next) {
    visit_reached(index, [&](const Place& place) {
      const int64_t at = kinds_.find(place);
      if (at < 0 || kinds_.kinds[at] == OUT || known_[static_cast<size_t>(at)]) return;
      known_[static_cast<size_t>(at)] = REACHED;
      take_near(place, static_cast<size_t>(at), next);
    });
  }

  void take_near(const Place& place, size_t at, std::vector<int64_t>& next) {
    if (known_[at] != REACHED || depth_[at] == BRICK) return;
    known_[at] = RIM;
    next.push_back(pack(place));
  }

  // Tell the bricks around one how many cells lie between them and what is taken (see rims.py).
  void approach(const Place& place, int depth, std::vector<int64_t>& next) {
    for (int64_t x = -1; x <= 1; ++x)
      for (int64_t y = -1; y <= 1; ++y)
        for (int64_t z = -1; z <= 1; ++z) {
          const Place near{place[0] + x, place[1] + y, place[2] + z};
          const int64_t found = kinds_.find(near);
          if (found < 0 || depth_[static_cast<size_t>(found)] <= depth) continue;
          const size_t at = static_cast<size_t>(found);
          const bool is_way = known_[at] == RIM;
          depth_[at] = static_cast<uint8_t>(depth);
          take_near(near, at, next);
          if (is_way) lead_on(near, next);
        }
  }

  // Go on through a brick of the rim.
  void lead_on(const Place& place, std::vector<int64_t>& next) {
    const int depth = depth_[static_cast<size_t>(kinds_.find(place))];
    const int beyond = depth + (BRICK >> grid_.strides.at(pack(place)));
    if (beyond < BRICK) approach(place, beyond, next);
  }

  const Field& field_;
  const Grid& grid_;
  const Kinds& kinds_;
  std::vector<uint8_t> known_, depth_;
  std::vector<int64_t> keys_, rim_, exits_;
  size_t taken_ = 0;
  std::vector<float*> values_;
  std::deque<LineShifts> shifts_;  // none where all strides are 1
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
  return python_object("types.brick_mesh", "BrickMesh")(
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
  const Input triangles = nb::cast<Input>(python_object("case_table", "case_triangles")());
  const CaseTable table(triangles);
  const int workers = check_threads(threads);
  Extracted mesh;
  Bricks all;
  Large<int64_t> exits;
  {
    const Unlocked unlocked;
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

Output<int64_t> seed_bricks(nb::handle grid_of, Doubles positions) {
  const Grid grid = take_grid(grid_of);
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const int64_t count = rows_of(positions);
  Large<int64_t> seeds;
  {
    const Unlocked unlocked;
    BrickSet held(grid.bricks);
    visit_places(point, count, grid.origin, BRICK * grid.step, [&](int64_t, const Place& place) { held.add(place); });
    seeds = held.keys();
  }
  return give(std::move(seeds));
}

}  // namespace

HPC_KERNELS {
  module.def("seed_bricks", &seed_bricks, "grid"_a, "positions"_a);
  module.def("grow_surface", &grow_surface, "field"_a, "grid"_a, "kinds"_a, "threads"_a = 1);
}

}  // namespace hpc
