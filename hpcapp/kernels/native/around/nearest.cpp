// The nearest neighbours of points, in whole numbers (see around/nearest.py).
#include "nearest.h"

#include <algorithm>
#include <cmath>

#include "arrays.h"
#include "clones.h"

namespace hpc {
namespace {

constexpr int RINGS = 3;          // of cells around one, at most: 15 spacings
constexpr double MOST_MARGIN = RINGS * static_cast<double>(CELL_UNITS), LEAST_MARGIN = 0.2 * CELL_UNITS;
constexpr int LANES = 32;
constexpr double GUESSED = 1.2;   // of the last point's squared distance
constexpr size_t MANY = 3;        // times what is wanted: more points around are worth a cut
constexpr double SMALLER = 0.8;   // how wide what lies around a part may be, of the whole
constexpr int64_t OUTERMOST = BIAS - RINGS - 1;  // cells whose neighbours have keys

// Points are placed in chunks of so many: their coordinates are one row of lanes, axes in turn.
constexpr int CHUNK = 64;

struct Chunk {
  double cells[3 * CHUNK], within[3 * CHUNK];  // in cells, and in units from their corners
};

// Find the cells of some points; return whether all are on the lattice.
HPC_CLONES bool place_chunk(const double* points, int width, const double* low, double unit, Chunk& placed) {
  constexpr double EDGE = static_cast<double>(CELL_UNITS), LIMIT = static_cast<double>(OUTERMOST);
  double corner[3 * CHUNK];
  int64_t off[3 * CHUNK];
  for (int i = 0; i < 3 * CHUNK; ++i) corner[i] = low[i % 3];
  HPC_LANES
  for (int i = 0; i < 3 * width; ++i) {
    const double units = std::rint((points[i] - corner[i]) / unit), cell = std::floor(units / EDGE);
    placed.cells[i] = cell;
    placed.within[i] = units - cell * EDGE;
    off[i] = !(cell > -LIMIT) | !(cell < LIMIT);
  }
  int64_t any = 0;
  for (int i = 0; i < 3 * width; ++i) any |= off[i];
  return !any;
}

inline Place place_at(const Chunk& placed, int i) {
  Place place;
  for (int axis = 0; axis < 3; ++axis) place[axis] = static_cast<int64_t>(placed.cells[3 * i + axis]);
  return place;
}

// Call body(chunk, start, width) for chunks of points that are placed.
template <class Body>
void visit_chunks(const double* points, int64_t count, const double* low, double unit, const Body& body) {
  Chunk placed;
  for (int64_t start = 0; start < count; start += CHUNK) {
    const int width = static_cast<int>(std::min<int64_t>(CHUNK, count - start));
    if (!place_chunk(points + 3 * start, width, low, unit, placed))
      refuse("positions: a point lies off the lattice (not finite, or too many cells away)");
    body(placed, start, width);
  }
}

HPC_CLONES void measure(const double* x, const double* y, const double* z, size_t count, const double* point,
                        double* squares) {
  const double px = point[0], py = point[1], pz = point[2];
  HPC_LANES
  for (size_t i = 0; i < count; ++i) {
    const double ax = x[i] - px, ay = y[i] - py, az = z[i] - pz;
    squares[i] = ax * ax + ay * ay + az * az;
  }
}

// Count how many values are lower than each; there is room for whole vectors.
HPC_CLONES void rank(const float* values, int count, int32_t* ranks) {
  for (int start = 0; start < count; start += LANES) {
    int32_t lower[LANES] = {};
    for (int j = 0; j < count; ++j) {
      const float value = values[j];
      HPC_LANES
      for (int lane = 0; lane < LANES; ++lane) lower[lane] += value < values[start + lane];
    }
    for (int lane = 0; lane < LANES; ++lane) ranks[start + lane] = lower[lane];
  }
}

}  // namespace

UnitPoints place_points(const double* points, int64_t count, const double* low, double spacing) {
  UnitPoints placed;
  placed.rows = make_buffer<uint32_t>(count);
  placed.places = make_buffer<int32_t>(3 * count);
  placed.offsets.push_back(0);
  if (!count) return placed;
  auto units = make_buffer<int32_t>(3 * count);  // as `places`, in the order of the cloud
  const double unit = spacing / UNITS;
  Place least = {BIAS, BIAS, BIAS}, most = {-BIAS, -BIAS, -BIAS};
  visit_chunks(points, count, low, unit, [&](const Chunk& chunk, int64_t start, int width) {
    for (int i = 0; i < 3 * width; ++i) units[3 * start + i] = static_cast<int32_t>(chunk.within[i]);
    for (int i = 0; i < 3 * width; ++i) {
      const int64_t cell = static_cast<int64_t>(chunk.cells[i]);
      least[i % 3] = std::min(least[i % 3], cell);
      most[i % 3] = std::max(most[i % 3], cell);
    }
  });
  const Span span(least, most);
  Ranking ranked(count, span.bits());
  visit_chunks(points, count, low, unit, [&](const Chunk& chunk, int64_t start, int width) {
    for (int i = 0; i < width; ++i) ranked.add(start + i, span.squeeze(place_at(chunk, i)));
  });
  ranked.sort();
  for (int64_t i = 0; i < count; ++i) {
    fetch(units.get() + 3 * static_cast<int64_t>(ranked.row(std::min(i + AHEAD, count - 1))));
    placed.rows[i] = ranked.row(i);
    for (int axis = 0; axis < 3; ++axis)
      placed.places[3 * i + axis] = units[3 * static_cast<int64_t>(placed.rows[i]) + axis];
    if (!ranked.begins(i)) continue;
    placed.keys.push_back(pack(span.restore(ranked.key(i))));
    if (i) placed.offsets.push_back(i);
  }
  placed.offsets.push_back(count);
  return placed;
}

NearestSearch::NearestSearch(const UnitPoints& points, int most, int reach)
    : points_(points), most_(most), reach_(reach * UNITS), guess_(reach_ * reach_) {
  for (int rings = 1; rings <= RINGS; ++rings)
    fingers_.emplace_back((2 * rings + 1) * (2 * rings + 1), Finger(points.keys.data(), points.cells()));
  const size_t room = 2 * (static_cast<size_t>(most) + 1) + LANES;
  for (auto* column : {&x_, &y_, &z_, &ordered_}) column->resize(room);
  for (auto* column : {&order_, &at_}) column->resize(room);
  for (auto* column : {&ranks_, &ties_}) column->resize(room);
  rounded_.resize(room);
}

void NearestSearch::search(int64_t cell, const std::vector<int>& wanted, const Take& take) {
  first_ = points_.offsets[cell];
  std::vector<int>&todo = around(0).wanted, &rest = around(0).unsolved;
  todo = wanted;
  // As far as neighbours were last: most probably, that tells them.
  double margin = std::max(std::sqrt(guess_), LEAST_MARGIN);
  for (; !todo.empty(); margin *= 2.0) {
    gather(cell, std::min(margin, MOST_MARGIN));
    rest.clear();
    solve(0, todo, rest, take);
    todo.swap(rest);
  }
}

void NearestSearch::Around::make_room(size_t most) {
  if (at.size() >= most) return;
  for (auto* column : {&x, &y, &z}) column->resize(most);
  at.resize(most);
}

NearestSearch::Around& NearestSearch::around(size_t depth) {
  while (stack_.size() <= depth) stack_.emplace_back();
  return stack_[depth];
}

// Take what lies so far around a cell.
void NearestSearch::gather(int64_t cell, double margin) {
  Around& all = around(0);
  const double edge = static_cast<double>(CELL_UNITS), high = edge + margin;
  const int rings = static_cast<int>(std::ceil(margin / edge));
  all.box = Box{{0.0, 0.0, 0.0}, edge, margin};
  all.count = 0;
  const int64_t key = points_.keys[cell];
  Finger* finger = fingers_[static_cast<size_t>(rings) - 1].data();
  for (int x = -rings; x <= rings; ++x)
    for (int y = -rings; y <= rings; ++y) {
      const int64_t middle = key + x * STRIDES[0] + y * STRIDES[1];
      int64_t row = finger++->lower_bound(middle - rings);
      for (; row < points_.cells() && points_.keys[row] <= middle + rings; ++row) {
        const int64_t start = points_.offsets[row], stop = points_.offsets[row + 1];
        const double corner[3] = {x * edge, y * edge, static_cast<double>(points_.keys[row] - middle) * edge};
        all.make_room(all.count + static_cast<size_t>(stop - start));
        size_t count = all.count;
        for (int64_t i = start; i < stop; ++i) {
          const double px = corner[0] + points_.places[3 * i], py = corner[1] + points_.places[3 * i + 1];
          const double pz = corner[2] + points_.places[3 * i + 2];
          all.x[count] = px;
          all.y[count] = py;
          all.z[count] = pz;
          all.at[count] = static_cast<uint32_t>(i);
          count += (px >= -margin) & (px <= high) & (py >= -margin) & (py <= high) & (pz >= -margin) & (pz <= high);
        }
        all.count = count;
      }
    }
}

// Find the neighbours of points of a box from what is known around it; name those that it does not tell.
void NearestSearch::solve(size_t depth, const std::vector<int>& wanted, std::vector<int>& unsolved,
                          const Take& take) {
  Around& all = around(depth);
  const std::vector<int>* rest = &wanted;
  size_t next = 0;
  if (all.count > MANY * static_cast<size_t>(most_) && wanted.size() > 1) {
    const bool is_found = find(all, wanted[next++], take);  // tells how dense the points are here
    if (!is_found) unsolved.push_back(wanted[0]);
    Around& part = around(depth + 1);
    if (is_found && cut(all.box, part.box)) {
      all.some.clear();
      all.octants.clear();
      for (const int one : wanted) {
        const int32_t* place = points_.places.get() + 3 * (first_ + one);
        int octant = 0;
        for (int axis = 0; axis < 3; ++axis) octant |= (place[axis] >= all.box.low[axis] + part.box.edge) << axis;
        all.octants.push_back(octant);
      }
      for (int octant = 0; octant < 8; ++octant) {
        const double edge = part.box.edge;
        for (int axis = 0; axis < 3; ++axis)
          part.box.low[axis] = all.box.low[axis] + (octant >> axis & 1 ? edge : 0.0);
        part.wanted.clear();
        for (size_t i = next; i < wanted.size(); ++i)
          if (all.octants[i] == octant) part.wanted.push_back(wanted[i]);
        if (part.wanted.empty()) continue;
        filter(all, part);
        solve(depth + 1, part.wanted, all.some, take);
      }
      rest = &all.some;
      next = 0;
    }
  }
  for (; next < rest->size(); ++next)
    if (!find(all, (*rest)[next], take)) unsolved.push_back((*rest)[next]);
}

// Cut a box into eight, with a margin as wide as neighbours are far; return whether it is worth it.
bool NearestSearch::cut(const Box& box, Box& part) const {
  part.edge = 0.5 * box.edge;
  part.margin = std::min(box.margin, std::sqrt(guess_));
  return part.edge + 2.0 * part.margin < SMALLER * (box.edge + 2.0 * box.margin);
}

void NearestSearch::filter(const Around& all, Around& part) const {
  double low[3], high[3];
  for (int axis = 0; axis < 3; ++axis) {
    low[axis] = part.box.low[axis] - part.box.margin;
    high[axis] = part.box.low[axis] + part.box.edge + part.box.margin;
  }
  part.make_room(all.count);
  size_t count = 0;
  for (size_t i = 0; i < all.count; ++i) {
    const double x = all.x[i], y = all.y[i], z = all.z[i];
    part.x[count] = x;
    part.y[count] = y;
    part.z[count] = z;
    part.at[count] = all.at[i];
    count += (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]) & (z >= low[2]) & (z <= high[2]);
  }
  part.count = count;
}

// Find the neighbours of a point; return whether what is known tells them.
bool NearestSearch::find(const Around& all, int one, const Take& take) {
  double point[3], within = reach_;
  for (int axis = 0; axis < 3; ++axis) {
    point[axis] = points_.places[3 * (first_ + one) + axis];
    const double below = point[axis] - all.box.low[axis];
    within = std::min(within, all.box.margin + std::min(below, all.box.edge - below));
  }
  if (squares_.size() < all.count) {
    squares_.resize(all.count);
    near_.resize(all.count + 1);
  }
  measure(all.x.data(), all.y.data(), all.z.data(), all.count, point, squares_.data());
  const double known = within * within, bound = std::min(known, guess_);
  int found = take_below(all.count, bound);
  if (found <= most_ && bound < known) found = take_below(all.count, known);
  if (found <= most_ && within < reach_) return false;
  const int listed = put_in_order(all, point, found);
  take(one, Neighbours{x_.data(), y_.data(), z_.data(), ordered_.data(), at_.data(), listed});
  return true;
}

// List the points nearer than a bound; return how many they are.
int NearestSearch::take_below(size_t count, double bound) {
  const double* squares = squares_.data();
  uint32_t* near = near_.data();
  size_t found = 0;
  for (size_t i = 0; i < count; ++i) {
    near[found] = static_cast<uint32_t>(i);
    found += squares[i] < bound;
  }
  return static_cast<int>(found);
}

// Keep the nearest of the listed points, and one more.
void NearestSearch::take_nearest(size_t count, int found) {
  near_squares_.resize(static_cast<size_t>(found));
  for (int i = 0; i < found; ++i) near_squares_[i] = squares_[near_[i]];
  std::nth_element(near_squares_.begin(), near_squares_.begin() + most_, near_squares_.end());
  const double last = near_squares_[most_];
  const int nearer = take_below(count, last);
  size_t i = 0;
  for (int kept = nearer; kept <= most_; ++i)
    if (squares_[i] == last) near_[kept++] = static_cast<uint32_t>(i);
}

// Bring the listed points into the order of their distances; return how many are kept.
int NearestSearch::put_in_order(const Around& all, const double (&point)[3], int found) {
  if (found > 2 * (most_ + 1)) {
    take_nearest(all.count, found);
    found = most_ + 1;
  }
  // Rounded distances tell nearly all of them apart: the rest is sorted.
  for (int i = 0; i < found; ++i) rounded_[i] = static_cast<float>(squares_[near_[i]]);
  rank(rounded_.data(), found, ranks_.data());
  std::fill_n(ties_.begin(), found, 0);
  int tied = 0;
  for (int i = 0; i < found; ++i) {
    const int tie = ties_[ranks_[i]]++;
    tied |= tie;
    order_[ranks_[i] + tie] = near_[i];
  }
  const double* squares = squares_.data();
  if (tied)
    std::sort(order_.begin(), order_.begin() + found,
              [squares](uint32_t a, uint32_t b) { return squares[a] < squares[b]; });
  const int listed = std::min(found, most_ + 1);
  for (int i = 0; i < listed; ++i) {
    const uint32_t row = order_[i];
    ordered_[i] = squares[row];
    x_[i] = all.x[row] - point[0];
    y_[i] = all.y[row] - point[1];
    z_[i] = all.z[row] - point[2];
    at_[i] = all.at[row];
  }
  guess_ = found > most_ ? GUESSED * ordered_[most_] + 1.0 : reach_ * reach_;
  return listed;
}

}  // namespace hpc
