// Points on a lattice: counting occupied boxes, sorting by cell, the bricks that hold a point.
#include "clones.h"
#include "families.h"
#include "keys.h"

namespace hpc {
namespace {

// Return the cell of a point; a point that is not finite or too far out has none.
inline Place cell_of(const double* point, const double* origin, double size) {
  Place place;
  for (int axis = 0; axis < 3; ++axis) {
    const double lower = std::floor((point[axis] - origin[axis]) / size);
    if (!(lower >= -static_cast<double>(BIAS) && lower < static_cast<double>(BIAS)))
      refuse("positions: a point lies off the lattice (not finite, or too many cells away)");
    place[axis] = static_cast<int64_t>(lower);
  }
  return place;
}

// A set of keys that only counts.
class KeyCounter {
 public:
  explicit KeyCounter(size_t expected) {
    size_t size = 1024;
    while (size < 2 * expected) size *= 2;
    slots_.assign(size, -1);
  }

  void add(int64_t key) {
    if (2 * (count_ + 1) > slots_.size()) grow();
    insert(key);
  }

  int64_t count() const { return static_cast<int64_t>(count_); }

 private:
  void insert(int64_t key) {
    size_t at = (static_cast<uint64_t>(key) * 0x9E3779B97F4A7C15u >> 20) & (slots_.size() - 1);
    while (slots_[at] != -1 && slots_[at] != key) at = (at + 1) & (slots_.size() - 1);
    count_ += slots_[at] == -1;
    slots_[at] = key;
  }

  void grow() {
    std::vector<int64_t> old(slots_.size() * 2, -1);
    old.swap(slots_);
    count_ = 0;
    for (int64_t key : old)
      if (key != -1) insert(key);
  }

  std::vector<int64_t> slots_;
  size_t count_ = 0;
};

void bound(const double* points, int64_t count, double* least, double* most) {
  for (int axis = 0; axis < 3; ++axis) least[axis] = most[axis] = points[axis];
  for (int64_t i = 1; i < count; ++i)
    for (int axis = 0; axis < 3; ++axis) {
      const double value = points[3 * i + axis];
      least[axis] = value < least[axis] ? value : least[axis];
      most[axis] = value > most[axis] ? value : most[axis];
    }
}

struct PlaceRange {
  Place low, high;
};

// Rank points by their cells; return false where one lies beyond the range, as only NaN does.
HPC_CLONES bool rank_range(const double* points, int64_t count, const double* origin, double size,
                           const PlaceRange& range, const Span& span, Ranked* ranked) {
  bool within = true;
  for (int64_t i = 0; i < count; ++i) {
    Place place;
    for (int axis = 0; axis < 3; ++axis) {
      const double lower = std::floor((points[3 * i + axis] - origin[axis]) / size);
      const bool inside = lower >= static_cast<double>(range.low[axis]) && lower <= static_cast<double>(range.high[axis]);
      place[axis] = inside ? static_cast<int64_t>(lower) : range.low[axis];
      within = within && inside;
    }
    ranked[i] = {span.squeeze(place), static_cast<uint32_t>(i)};
  }
  return within;
}

nb::tuple bound_points(Input positions) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const int64_t count = rows_of(positions);
  if (!count) refuse("positions: expected at least one point");
  auto low = make_buffer<double>(3), high = make_buffer<double>(3);
  {
    nb::gil_scoped_release unlocked;
    bound(point, count, low.get(), high.get());
  }
  return nb::make_tuple(give(std::move(low), {3}), give(std::move(high), {3}));
}

// Return whether a box is in the sample of about one in so many, chosen by a hash.
inline bool is_sampled(int64_t key, int64_t one_in) {
  const uint64_t mixed = static_cast<uint64_t>(key) * 0x9E3779B97F4A7C15u >> 33;
  return mixed * static_cast<uint64_t>(one_in) >> 31 == 0;
}

nb::tuple count_boxes(Input positions, Input low, double edge, int64_t one_in) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const double* origin = check<double>(low, "low", {3});
  check_positive(edge, "edge");
  if (one_in < 1 || one_in > UINT32_MAX) refuse("one_in: expected 1 to 2^32 - 1");
  const int64_t count = rows_of(positions);
  int64_t kept = 0, boxes = 0;
  {
    nb::gil_scoped_release unlocked;
    KeyCounter counter(static_cast<size_t>(count / one_in / 4));
    for (int64_t i = 0; i < count; ++i) {
      const int64_t key = pack(cell_of(point + 3 * i, origin, edge));
      if (!is_sampled(key, one_in)) continue;
      ++kept;
      counter.add(key);
    }
    boxes = counter.count();
  }
  return nb::make_tuple(kept, boxes);
}

Output<int64_t> sample_boxes(Input positions, Input low, double edge, int64_t one_in) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const double* origin = check<double>(low, "low", {3});
  check_positive(edge, "edge");
  if (one_in < 1 || one_in > UINT32_MAX) refuse("one_in: expected 1 to 2^32 - 1");
  const int64_t count = rows_of(positions);
  Large<int64_t> rows;
  {
    nb::gil_scoped_release unlocked;
    for (int64_t i = 0; i < count; ++i)
      if (is_sampled(pack(cell_of(point + 3 * i, origin, edge)), one_in)) rows.push_back(i);
  }
  return give(std::move(rows));
}

}  // namespace

Large<Ranked> rank_points(const double* points, int64_t count, const double* origin,
                          double size, Span& span) {
  double least[3], most[3];
  bound(points, count, least, most);
  const Place low = cell_of(least, origin, size), high = cell_of(most, origin, size);
  span = Span(low, high);
  Large<Ranked> ranked(static_cast<size_t>(count));
  if (!rank_range(points, count, origin, size, {low, high}, span, ranked.data()))
    refuse("positions: a point is not finite");
  radix_sort(ranked, span.bits());
  return ranked;
}

namespace {

nb::tuple sort_points(Input positions, Input origin_of, double size) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const int64_t count = rows_of(positions);
  const double* origin = check<double>(origin_of, "origin", {3});
  check_positive(size, "cell_size");
  if (!count || count >= UINT32_MAX) refuse("positions: expected 1 to 2^32 - 1 points");
  Large<int64_t> cells, offsets;
  Buffer<uint32_t> rows;
  {
    nb::gil_scoped_release unlocked;
    Span span({0, 0, 0}, {0, 0, 0});
    const Large<Ranked> ranked = rank_points(point, count, origin, size, span);
    int64_t runs = 0;
    for (int64_t i = 0; i < count; ++i) runs += !i || ranked[i].key != ranked[i - 1].key;
    cells.reserve(runs);
    offsets.reserve(runs + 1);
    rows = make_buffer<uint32_t>(count);
    for (int64_t i = 0; i < count; ++i) {
      rows[i] = ranked[i].row;
      if (i && ranked[i].key == ranked[i - 1].key) continue;
      cells.push_back(pack(span.restore(ranked[i].key)));
      offsets.push_back(i);
    }
    offsets.push_back(count);
  }
  return nb::make_tuple(give(std::move(cells)), give(std::move(offsets)),
                        give(std::move(rows), {static_cast<size_t>(count)}));
}

nb::tuple gather_points(Input positions, Input normals, Input rows_wanted, Input origin_of, double size) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const int64_t known = rows_of(positions);
  const double* normal = check<double>(normals, "normals", {known, 3});
  const uint32_t* rows = check<uint32_t>(rows_wanted, "rows", {ANY});
  const int64_t count = rows_of(rows_wanted);
  const double* origin = check<double>(origin_of, "origin", {3});
  check_positive(size, "cell_size");
  for (int64_t i = 0; i < count; ++i)
    if (rows[i] >= known) refuse("rows: a point that is not there");
  auto local = make_buffer<double>(3 * count);
  auto gathered = make_buffer<double>(3 * count);
  {
    nb::gil_scoped_release unlocked;
    for (int64_t i = 0; i < count; ++i) {
      // Neighbours in space lie anywhere in the file: ask for what comes soon.
      const int64_t soon = 3 * static_cast<int64_t>(rows[std::min(i + AHEAD, count - 1)]);
      fetch(point + soon);
      fetch(normal + soon);
      for (int axis = 0; axis < 3; ++axis) {
        const int64_t from = 3 * static_cast<int64_t>(rows[i]) + axis;
        const double place = (point[from] - origin[axis]) / size;
        local[3 * i + axis] = place - std::floor(place) - 0.5;
        gathered[3 * i + axis] = normal[from];
      }
    }
  }
  const size_t n = static_cast<size_t>(count);
  return nb::make_tuple(give(std::move(local), {n, 3}), give(std::move(gathered), {n, 3}));
}

Output<int64_t> seed_bricks(Input positions, Input origin_of, double edge, Input bricks) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const double* origin = check<double>(origin_of, "origin", {3});
  const int64_t* sides = check_sides(bricks);
  check_positive(edge, "edge");
  const int64_t count = rows_of(positions);
  Large<int64_t> seeds;
  {
    nb::gil_scoped_release unlocked;
    std::vector<bool> held(static_cast<size_t>(sides[0] * sides[1] * sides[2]));
    for (int64_t i = 0; i < count; ++i) {
      const Place place = cell_of(point + 3 * i, origin, edge);
      for (int axis = 0; axis < 3; ++axis)
        if (place[axis] < 0 || place[axis] >= sides[axis]) refuse("positions: a point lies off the grid");
      held[static_cast<size_t>((place[0] * sides[1] + place[1]) * sides[2] + place[2])] = true;
    }
    int64_t at = 0;
    for (int64_t x = 0; x < sides[0]; ++x)
      for (int64_t y = 0; y < sides[1]; ++y)
        for (int64_t z = 0; z < sides[2]; ++z)
          if (held[static_cast<size_t>(at++)]) seeds.push_back(pack({x, y, z}));
  }
  return give(std::move(seeds));
}

}  // namespace

const int64_t* check_sides(const Input& bricks) {
  const int64_t* sides = check<int64_t>(bricks, "bricks", {3});
  for (int axis = 0; axis < 3; ++axis)
    if (sides[axis] < 1 || sides[axis] > 2048) refuse("bricks: expected 1 to 2048 along each axis");
  return sides;
}

void bind_points(nb::module_& module) {
  module.def("bound_points", &bound_points);
  module.def("count_boxes", &count_boxes);
  module.def("sample_boxes", &sample_boxes);
  module.def("sort_points", &sort_points);
  module.def("gather_points", &gather_points);
  module.def("seed_bricks", &seed_bricks);
}

}  // namespace hpc
