// The implicit function over bricks: quadrics in (x, y, z) collapse along z, then y, then x.
//
// Lanes run over x while z and y collapse, and over (y, z) while x does; what a node gets depends
// on its own index only. All in single precision, but for where the nodes lie and the far field.
//
// The loops over lanes index plain pointers: through a lambda GCC no longer sees what to vectorise.
#include "field.h"

#include <algorithm>

#include "arrays.h"
#include "constants.h"
#include "feature_blend.h"
#include "layers.h"
#include "threads.h"
#include "transpose.h"

namespace hpc {
namespace {

using constants::field::CHANNELS;

constexpr int AFTER_Z = 8, AFTER_Y = 5;
constexpr size_t MOST_LEVELS = 32;
constexpr int PLANE = 88;  // the 81 nodes of a (y, z) plane, rounded up to whole vectors

// The nodes of a (y, z) plane of fewer, rounded up likewise.
constexpr int plane_of(int nodes) { return (nodes * nodes + 7) / 8 * 8; }

constexpr Real TINY = static_cast<Real>(constants::field::TINY);
constexpr Real LEAST_REST = static_cast<Real>(constants::field::LEAST_REST);
constexpr double HULL_REACH = constants::field::HULL_REACH;

// Sizes of the intermediate arrays of a brick; x is padded to whole vectors.
struct Shape {
  int x, y, z, lanes;
};

// Collapse z. raw: [channel][z][y][lanes]; out: [channel][y][node][lanes], with
// [1, x, y, xx, yy, xy, presence, trust].
HPC_INLINE void collapse_z(const Real* __restrict raw, const Shape& shape, const Axis& axis, Real* __restrict out, const int lanes, const int nodes) {
  const int64_t from = int64_t{1} * shape.z * shape.y * lanes, to = int64_t{1} * shape.y * nodes * lanes;
  for (int y = 0; y < shape.y; ++y)
    for (int node = 0; node < nodes; ++node) {
      const Real w = static_cast<Real>(axis.weight[node]), v = static_cast<Real>(1.0 - axis.weight[node]);
      const Real t = static_cast<Real>(axis.local[node]), s = static_cast<Real>(axis.local[node] - 1.0);
      const Real* __restrict a = raw + (axis.below[node] * shape.y + y) * lanes;
      const Real* b = a + shape.y * lanes;
      Real* __restrict o = out + (y * nodes + node) * lanes;
      HPC_LANES
      for (int i = 0; i < lanes; ++i) {
        o[i] = (a[i] + t * (a[3 * from + i] + t * a[6 * from + i])) * v + (b[i] + s * (b[3 * from + i] + s * b[6 * from + i])) * w;
        o[to + i] = (a[from + i] + t * a[9 * from + i]) * v + (b[from + i] + s * b[9 * from + i]) * w;
        o[2 * to + i] = (a[2 * from + i] + t * a[8 * from + i]) * v + (b[2 * from + i] + s * b[8 * from + i]) * w;
        o[3 * to + i] = a[4 * from + i] * v + b[4 * from + i] * w;
        o[4 * to + i] = a[5 * from + i] * v + b[5 * from + i] * w;
        o[5 * to + i] = a[7 * from + i] * v + b[7 * from + i] * w;
        o[6 * to + i] = a[10 * from + i] * v + b[10 * from + i] * w;
        o[7 * to + i] = a[11 * from + i] * v + b[11 * from + i] * w;
      }
    }
}

// Collapse y. in: [channel][y][z node][lanes]; out: [channel][y node][z node][lanes], with
// [1, x, xx, presence, trust].
HPC_INLINE void collapse_y(const Real* __restrict in, const Shape& shape, const Axis& axis, Real* __restrict out, const int lanes, const int nodes) {
  const int64_t from = int64_t{1} * shape.y * nodes * lanes, to = int64_t{1} * nodes * nodes * lanes;
  for (int node = 0; node < nodes; ++node) {
    const Real w = static_cast<Real>(axis.weight[node]), v = static_cast<Real>(1.0 - axis.weight[node]);
    const Real t = static_cast<Real>(axis.local[node]), s = static_cast<Real>(axis.local[node] - 1.0);
    const Real* a = in + axis.below[node] * nodes * lanes;
    const Real* b = a + nodes * lanes;
    Real* __restrict o = out + node * nodes * lanes;
    HPC_LANES
    for (int i = 0; i < nodes * lanes; ++i) {
      o[i] = (a[i] + t * (a[2 * from + i] + t * a[4 * from + i])) * v + (b[i] + s * (b[2 * from + i] + s * b[4 * from + i])) * w;
      o[to + i] = (a[from + i] + t * a[5 * from + i]) * v + (b[from + i] + s * b[5 * from + i]) * w;
      o[2 * to + i] = a[3 * from + i] * v + b[3 * from + i] * w;
      o[3 * to + i] = a[6 * from + i] * v + b[6 * from + i] * w;
      o[4 * to + i] = a[7 * from + i] * v + b[7 * from + i] * w;
    }
  }
}

// in: [channel][plane node][lanes]; out: [channel][x][plane].
HPC_INLINE void turn(const Real* in, Real* out, const int lanes, const int nodes, const int plane) {
  const int plane_nodes = nodes * nodes;
  for (int channel = 0; channel < AFTER_Y; ++channel, in += plane_nodes * lanes, out += lanes * plane)
    for (int x = 0; x < lanes; x += 4) {
      const Real* rows[4];
      for (int i = 0; i < 4; ++i) rows[i] = in + i * lanes + x;
      int node = 0;
      for (; node + 4 <= plane_nodes; node += 4) {
        transpose_four(rows, out + x * plane + node, plane);
        for (auto& row : rows) row += 4 * lanes;
      }
      for (; node < plane_nodes; ++node)
        for (int i = 0; i < 4; ++i) out[(x + i) * plane + node] = in[node * lanes + x + i];
    }
}

// What the levels so far amount to at each node, [x][plane], and what is left to those behind.
struct Composite {
  Real *total, *rest;
};

// Collapse x, and blend behind the levels in front; `scale` is the size of the level's cells.
HPC_INLINE void collapse_x(const Real* in, const Shape& shape, const Axis& axis, Real scale,
                           const Composite& composite, const int nodes, const int plane) {
  const int64_t from = int64_t{1} * shape.lanes * plane;
  for (int node = 0; node < nodes; ++node) {
    const Real w = static_cast<Real>(axis.weight[node]), v = static_cast<Real>(1.0 - axis.weight[node]);
    const Real t = static_cast<Real>(axis.local[node]), s = static_cast<Real>(axis.local[node] - 1.0);
    const Real* a = in + axis.below[node] * plane;
    const Real* b = a + plane;
    Real* __restrict total = composite.total + node * plane;
    Real* __restrict rest = composite.rest + node * plane;
    bool open = false;
    for (int i = 0; i < plane; ++i) open |= rest[i] > 0;
    if (!open) continue;
    HPC_LANES
    for (int i = 0; i < plane; ++i) {
      const Real quadric =
          (a[i] + t * (a[from + i] + t * a[2 * from + i])) * v + (b[i] + s * (b[from + i] + s * b[2 * from + i])) * w;
      const Real presence = a[3 * from + i] * v + b[3 * from + i] * w, trust = a[4 * from + i] * v + b[4 * from + i] * w;
      const Real near = scale * quadric / (presence > 0 ? presence : 1);
      const Real left = rest[i] * (1 - trust);
      total[i] += rest[i] * trust * near;
      rest[i] = left < LEAST_REST ? 0 : left;
    }
  }
}

HPC_INLINE void collapse_axes(const Real* raw, Real* scratch, const Shape& shape, const Axis* axes, Real scale,
                              const Composite& composite, const int lanes, const int nodes, const int plane) {
  Real* first = scratch;
  Real* second = first + AFTER_Z * shape.y * nodes * lanes;
  Real* third = second + AFTER_Y * nodes * nodes * lanes;
  collapse_z(raw, shape, axes[2], first, lanes, nodes);
  collapse_y(first, shape, axes[1], second, lanes, nodes);
  turn(second, third, lanes, nodes, plane);
  collapse_x(third, shape, axes[0], scale, composite, nodes, plane);
}

HPC_CLONES void collapse(const Real* raw, Real* scratch, const Shape& shape, const Axis* axes,
                         Real scale, const Composite& composite) {
  const int nodes = axes[0].nodes;
  // The usual widths are constants to the compiler.
  if (nodes != NODES) {
    collapse_axes(raw, scratch, shape, axes, scale, composite, shape.lanes, nodes, plane_of(nodes));
  } else if (shape.lanes == 8) {
    collapse_axes(raw, scratch, shape, axes, scale, composite, 8, NODES, PLANE);
  } else if (shape.lanes == 12) {
    collapse_axes(raw, scratch, shape, axes, scale, composite, 12, NODES, PLANE);
  } else {
    collapse_axes(raw, scratch, shape, axes, scale, composite, shape.lanes, NODES, PLANE);
  }
}

// Interpolate the far field trilinearly, in cells of the finest lattice, behind all levels.
HPC_CLONES void add_far(const Field& field, const Axis* axes, const Composite& composite) {
  const int64_t side = field.far_nodes;
  const int nodes = axes[0].nodes, plane = plane_of(nodes);
  const auto kept = [side](int64_t layer) { return std::min(std::max<int64_t>(layer, 0), side - 1); };
  int64_t column[MOST_LAYERS];
  for (int z = 0; z < axes[2].count; ++z) column[z] = kept(axes[2].layer[z]);
  for (int x = 0; x < nodes; ++x)
    for (int y = 0; y < nodes; ++y) {
      const int i = axes[0].below[x], j = axes[1].below[y];
      const double t = axes[0].local[x], u = axes[1].local[y];
      const int64_t x0 = kept(axes[0].layer[i]) * side, x1 = kept(axes[0].layer[i + 1]) * side;
      const int64_t y0 = kept(axes[1].layer[j]), y1 = kept(axes[1].layer[j + 1]);
      const float* v = field.far_values;
      const float *a = v + (x0 + y0) * side, *b = v + (x1 + y0) * side;
      const float *c = v + (x0 + y1) * side, *d = v + (x1 + y1) * side;
      double row[MOST_LAYERS];
      for (int z = 0; z < axes[2].count; ++z) {
        const int64_t k = column[z];
        row[z] = (a[k] * (1.0 - t) + b[k] * t) * (1.0 - u) + (c[k] * (1.0 - t) + d[k] * t) * u;
      }
      for (int z = 0; z < nodes; ++z) {
        const int k = axes[2].below[z];
        const double w = axes[2].local[z];
        const int node = x * plane + y * nodes + z;
        const double far = (row[k] * (1.0 - w) + row[k + 1] * w) / field.cell_size;
        composite.total[node] += static_cast<Real>(composite.rest[node] * far);
      }
    }
}

// Move what lies beyond a plane of the hull outside (see field.py).
void cut_at_hull(const Field& field, const Grid& grid, const Place& brick, int every, Real* total) {
  const int nodes = BRICK / every + 1, plane_nodes = plane_of(nodes);
  const double least = -HULL_REACH * grid.step / field.cell_size;
  for (const double* plane = field.hull; plane != field.hull + 4 * field.planes; plane += 4) {
    // What a node adds along each axis: the sum is that of its index, whatever the brick.
    double added[3][NODES], most = -plane[3];
    for (int axis = 0; axis < 3; ++axis) {
      for (int node = 0; node < nodes; ++node) {
        const double index = static_cast<double>(brick[axis] * BRICK + int64_t{1} * node * every);
        added[axis][node] = plane[axis] * (grid.origin[axis] + index * grid.step);
      }
      most += std::max(added[axis][0], added[axis][nodes - 1]);
    }
    if (most / field.cell_size <= 1.5 * least) continue;
    for (int x = 0; x < nodes; ++x)
      for (int y = 0; y < nodes; ++y)
        for (int z = 0; z < nodes; ++z) {
          const double beyond = (added[0][x] + added[1][y] + added[2][z] - plane[3]) / field.cell_size;
          Real& value = total[x * plane_nodes + y * nodes + z];
          if (beyond > least) value = std::max(value, static_cast<Real>(beyond));
        }
  }
}

// Put the quadrics around a brick into raw: [channel][z][y][lanes]; 0 where a vertex is missing.
// Return whether there is any.
bool load_vertices(const FieldLevel& level, Finger& finger, const Axis* axes, const Shape& shape, Real* raw) {
  bool any = false;
  const int64_t plane = int64_t{1} * shape.y * shape.lanes, channel = shape.z * plane;
  std::fill(raw, raw + CHANNELS * channel, Real{0});
  for (int x = 0; x < shape.x; ++x)
    for (int y = 0; y < shape.y; ++y)
      for (int z = 0; z < shape.z; ++z) {
        const Place place{axes[0].layer[x], axes[1].layer[y], axes[2].layer[z]};
        if (!in_range(place[0]) || !in_range(place[1]) || !in_range(place[2])) continue;
        const int64_t key = pack(place), row = finger.lower_bound(key);
        if (row == level.vertices) continue;
        const int64_t ahead = level.keys[row] - key;
        if (ahead) {
          // Nothing between here and the next vertex: skip to it, or to the end of the column.
          if (axes[2].layer[shape.z - 1] - place[2] < ahead) break;
          continue;
        }
        Real* to = raw + z * plane + y * shape.lanes + x;
        for (int i = 0; i < 10; ++i) to[i * channel] = level.coefficients[row * 10 + i];
        to[10 * channel] = 1;
        to[11 * channel] = level.trust[row];
        any = true;
      }
  return any;
}

// Move the outermost nodes of the grid outside, so that every surface closes inside it.
void close_border(const Place& brick, const Grid& grid, int every, float* values) {
  bool edge = false;
  for (int axis = 0; axis < 3; ++axis) edge = edge || brick[axis] == 0 || brick[axis] == grid.bricks[axis] - 1;
  if (!edge) return;
  const auto outer = [&](int axis, int node) {
    const int64_t index = brick[axis] * BRICK + node;
    return index == 0 || index == grid.bricks[axis] * BRICK;
  };
  for (int x = 0; x < NODES; x += every)
    for (int y = 0; y < NODES; y += every)
      for (int z = 0; z < NODES; z += every, ++values)
        if (outer(0, x) || outer(1, y) || outer(2, z)) *values = std::fabs(*values);
}

Output<float> evaluate_bricks(nb::handle field_given, nb::handle grid_given, Integers places_of, int64_t threads) {
  const Grid grid = take_grid(grid_given);
  const Field field = take_field(field_given, grid);
  const int64_t* places = check<int64_t>(places_of, "places", {ANY, 3});
  const int64_t count = rows_of(places_of);
  for (int64_t i = 0; i < 3 * count; ++i)
    if (places[i] < 0 || places[i] >= grid.bricks[i % 3]) refuse("places: a brick lies off the grid");
  const int workers = check_threads(threads);
  auto values = make_buffer<float>(count * BRICK_NODES);
  {
    const Unlocked unlocked;
    run_ranges(count, workers, [&](int64_t start, int64_t stop) {
      BrickEvaluator evaluator(field, grid);
      for (int64_t i = start; i < stop; ++i) {
        const Place place{places[3 * i], places[3 * i + 1], places[3 * i + 2]};
        const LineShifts shifts = line_shifts(grid, place);
        float* out = values.get() + i * BRICK_NODES;
        if (shifts.are_zero()) {
          evaluator.evaluate(place, 1, out);
        } else {
          float nodes[BRICK_NODES];
          evaluator.evaluate(place, 1 << shifts.finest(), nodes);
          spread_nodes(nodes, shifts, out);
        }
      }
    });
  }
  return give(std::move(values), {static_cast<size_t>(count), NODES, NODES, NODES});
}

void take_origin(nb::handle given, double* origin) {
  const auto array = field_of<Doubles>(given, "origin");
  std::copy_n(check<double>(array, "origin", {3}), 3, origin);
  check_finite(origin, 3, "origin");
}

void take_levels(nb::handle given, Field& field) {
  const auto levels = field_of<nb::tuple>(given, "levels");
  if (levels.size() > MOST_LEVELS) refuse("levels: too many");
  for (const nb::handle level : levels) {
    const Input keys = field.hold<Integers>(level, "keys");
    const int64_t* sorted = check_keys(keys, "keys");
    const int64_t count = rows_of(keys);
    field.levels.push_back({sorted, count,
                            check<float>(field.hold<Singles>(level, "coefficients"), "coefficients", {count, 10}),
                            check<float>(field.hold<Singles>(level, "trust"), "trust", {count})});
  }
}

void take_features(nb::handle given, Field& field) {
  const auto levels = field_of<nb::tuple>(given, "features");
  if (levels.size() > field.levels.size()) refuse("features: of more levels than there are");
  for (const nb::handle features : levels) {
    const Input keys = field.hold<Input>(features, "keys");
    const int64_t* sorted = check_keys(keys, "keys");
    const int64_t count = rows_of(keys);
    field.features.push_back(
        {sorted, count, check<float>(field.hold<Input>(features, "pieces"), "pieces", {count, PIECES, BASIS}),
         check<uint8_t>(field.hold<Input>(features, "joints"), "joints", {count})});
  }
}

void take_far(nb::handle given, Field& field) {
  const auto far = field_of<nb::object>(given, "far");
  const Input values = field.hold<Input>(far, "values");
  field.far_nodes = values.ndim() == 3 ? rows_of(values) : 0;
  if (field.far_nodes < 2 || field.far_nodes > 1024) refuse("far: expected a cube of 2 to 1024 nodes");
  field.far_values = check<float>(values, "far", {field.far_nodes, field.far_nodes, field.far_nodes});
  field.far_step = field_of<double>(far, "step");
  take_origin(far, field.far_origin);
  check_positive(field.far_step, "far step");
  const Input hull = field.hold<Doubles>(far, "hull");
  field.hull = check<double>(hull, "hull", {ANY, 4});
  field.planes = rows_of(hull);
  check_finite(field.hull, 4 * field.planes, "hull");
}

void round_values(const Real* total, int nodes, float* values) {
  const int plane = plane_of(nodes);
  for (int x = 0; x < nodes; ++x)
    for (int i = 0; i < nodes * nodes; ++i) {
      const float value = total[x * plane + i];
      *values++ = value == 0.0f ? TINY : value;
    }
}

}  // namespace

Field take_field(nb::handle given, const Grid& grid) {
  Field field;
  take_origin(given, field.origin);
  field.cell_size = field_of<double>(given, "cell_size");
  check_positive(field.cell_size, "cell_size");
  take_levels(given, field);
  take_far(given, field);
  take_features(given, field);
  for (int axis = 0; axis < 3; ++axis) {
    const double reach = grid.step * BRICK * static_cast<double>(grid.bricks[axis]);
    const double low = std::fabs(grid.origin[axis] - field.origin[axis]) + reach;
    const double far_low = std::fabs(grid.origin[axis] - field.far_origin[axis]) + reach;
    // Beyond 2^40 cells the cast to an index is not safe.
    if (!(low / field.cell_size < 1e12) || !(far_low / field.far_step < 1e12))
      refuse("field: the grid reaches too many cells away");
  }
  return field;
}

BrickEvaluator::BrickEvaluator(const Field& field, const Grid& grid)
    : field_(field), grid_(grid), scratch_(3 * NODES * PLANE) {
  for (const Features& features : field.features) features_.emplace_back(features);
  for (const FieldLevel& level : field.levels) fingers_.emplace_back(level.keys, level.vertices);
}

BrickEvaluator::~BrickEvaluator() = default;

bool BrickEvaluator::add_level(const Place& brick, int every, size_t depth) {
  const double scale = std::ldexp(1.0, static_cast<int>(depth));
  Axis axes[3];
  for (int axis = 0; axis < 3; ++axis)
    axes[axis] =
        locate(brick[axis], every, grid_.step, grid_.origin[axis] - field_.origin[axis], field_.cell_size * scale);
  const int lanes = std::max(8, (axes[0].count + 3) / 4 * 4);
  const Shape shape{axes[0].count, axes[1].count, axes[2].count, lanes};
  const int nodes = axes[0].nodes, plane = plane_of(nodes);
  const size_t raw = static_cast<size_t>(CHANNELS * shape.z * shape.y * lanes);
  const size_t others = static_cast<size_t>(AFTER_Z * shape.y * nodes * lanes + AFTER_Y * nodes * nodes * lanes +
                                            AFTER_Y * lanes * plane);
  // Zeros also where a plane is padded: those lanes are computed and thrown away.
  const size_t needed = 3 * NODES * PLANE + raw + others;
  if (scratch_.size() < needed) scratch_.resize(needed, Real{0});
  const Composite composite{scratch_.data(), scratch_.data() + NODES * PLANE};
  Real* before = scratch_.data() + 2 * NODES * PLANE;  // what was left to this level
  Real* vertices = before + NODES * PLANE;
  if (!load_vertices(field_.levels[depth], fingers_[depth], axes, shape, vertices)) return true;
  const bool has_features = depth < features_.size() && features_[depth].find(axes);
  if (has_features) std::copy_n(composite.rest, NODES * PLANE, before);
  collapse(vertices, vertices + raw, shape, axes, static_cast<Real>(scale), composite);
  if (has_features)
    features_[depth].add(axes, vertices, int64_t{1} * shape.y * lanes, lanes, static_cast<Real>(scale), composite.total,
                         before, composite.rest, plane);
  for (int x = 0; x < nodes; ++x)
    for (int i = 0; i < nodes * nodes; ++i)
      if (composite.rest[x * plane + i] > 0) return true;
  return false;
}

void BrickEvaluator::evaluate(const Place& brick, int every, float* values) {
  std::fill(scratch_.begin(), scratch_.begin() + NODES * PLANE, Real{0});
  std::fill(scratch_.begin() + NODES * PLANE, scratch_.begin() + 2 * NODES * PLANE, Real{1});
  bool left = true;
  for (size_t depth = 0; left && depth < field_.levels.size(); ++depth) left = add_level(brick, every, depth);
  if (left) {
    Axis axes[3];
    for (int axis = 0; axis < 3; ++axis)
      axes[axis] =
          locate(brick[axis], every, grid_.step, grid_.origin[axis] - field_.far_origin[axis], field_.far_step);
    add_far(field_, axes, {scratch_.data(), scratch_.data() + NODES * PLANE});
  }
  cut_at_hull(field_, grid_, brick, every, scratch_.data());
  round_values(scratch_.data(), BRICK / every + 1, values);
  close_border(brick, grid_, every, values);
}

HPC_KERNELS {
  module.def("evaluate_bricks", &evaluate_bricks, "field"_a, "grid"_a, "places"_a, "threads"_a = 1);
}

}  // namespace hpc
