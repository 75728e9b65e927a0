// Points bounded, and counted, sampled and sorted in boxes and cells (see points.py).
#include "points.h"

#include "clones.h"

namespace hpc {

HPC_CLONES void place_chunk(const double* points, int width, const double* origin, double size, int32_t* places) {
  double corner[3 * POINTS_AT_ONCE];
  for (int i = 0; i < 3 * POINTS_AT_ONCE; ++i) corner[i] = origin[i % 3];
  HPC_LANES
  for (int i = 0; i < 3 * width; ++i) {
    const double lower = std::floor((points[i] - corner[i]) / size);
    const bool within = lower >= -static_cast<double>(BIAS) && lower < static_cast<double>(BIAS);
    places[i] = static_cast<int32_t>(within ? lower : static_cast<double>(OFF));
  }
}

namespace {

HPC_CLONES void bound(const double* points, int64_t count, double* least, double* most) {
  constexpr int WIDTH = 24;  // whole vectors, and whole points
  double low[WIDTH], high[WIDTH];
  for (int i = 0; i < WIDTH; ++i) low[i] = high[i] = points[i % 3];
  int64_t at = 0;
  for (; at + WIDTH <= 3 * count; at += WIDTH) {
    const double* some = points + at;
    HPC_LANES
    for (int i = 0; i < WIDTH; ++i) {
      low[i] = some[i] < low[i] ? some[i] : low[i];
      high[i] = some[i] > high[i] ? some[i] : high[i];
    }
  }
  for (int i = 0; at < 3 * count; ++i, ++at) {
    low[i] = points[at] < low[i] ? points[at] : low[i];
    high[i] = points[at] > high[i] ? points[at] : high[i];
  }
  for (int axis = 0; axis < 3; ++axis) {
    least[axis] = low[axis];
    most[axis] = high[axis];
    for (int i = axis; i < WIDTH; i += 3) {
      least[axis] = std::min(least[axis], low[i]);
      most[axis] = std::max(most[axis], high[i]);
    }
  }
}

// Return whether a box is in the sample of about one in so many, chosen by a hash.
inline bool is_sampled(int64_t key, int64_t one_in) {
  const uint64_t mixed = static_cast<uint64_t>(key) * 0x9E3779B97F4A7C15u >> 33;
  return mixed * static_cast<uint64_t>(one_in) >> 31 == 0;
}

nb::tuple count_boxes(Doubles positions, Doubles low, double edge, int64_t one_in) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const double* origin = check<double>(low, "low", {3});
  check_positive(edge, "edge");
  if (one_in < 1 || one_in > UINT32_MAX) refuse("one_in: expected 1 to 2^32 - 1");
  const int64_t count = rows_of(positions);
  int64_t kept = 0, boxes = 0;
  {
    const Unlocked unlocked;
    KeySet counter(static_cast<size_t>(count / one_in / 4));
    visit_places(point, count, origin, edge, [&](int64_t, const Place& place) {
      const int64_t key = pack(place);
      if (!is_sampled(key, one_in)) return;
      ++kept;
      counter.add(key);
    });
    boxes = counter.count();
  }
  return nb::make_tuple(kept, boxes);
}

Output<int64_t> sample_boxes(Doubles positions, Doubles low, double edge, int64_t one_in) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const double* origin = check<double>(low, "low", {3});
  check_positive(edge, "edge");
  if (one_in < 1 || one_in > UINT32_MAX) refuse("one_in: expected 1 to 2^32 - 1");
  const int64_t count = rows_of(positions);
  Large<int64_t> rows;
  {
    const Unlocked unlocked;
    visit_places(point, count, origin, edge, [&](int64_t i, const Place& place) {
      if (is_sampled(pack(place), one_in)) rows.push_back(i);
    });
  }
  return give(std::move(rows));
}

}  // namespace

Ranking rank_points(const double* points, int64_t count, const double* origin, double size, Span& span) {
  double corners[6];
  bound(points, count, corners, corners + 3);
  Place bounds[2];
  visit_places(corners, 2, origin, size, [&](int64_t i, const Place& place) { bounds[i] = place; });
  span = Span(bounds[0], bounds[1]);
  Ranking ranked(count, span.bits());
  visit_places(points, count, origin, size, [&](int64_t i, const Place& place) { ranked.add(i, span.squeeze(place)); });
  ranked.sort();
  return ranked;
}

namespace {

nb::tuple sort_points(Doubles positions, Doubles origin_of, double size) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const int64_t count = rows_of(positions);
  const double* origin = check<double>(origin_of, "origin", {3});
  check_positive(size, "cell_size");
  if (!count || count >= UINT32_MAX) refuse("positions: expected 1 to 2^32 - 1 points");
  Large<int64_t> cells, offsets;
  Buffer<uint32_t> rows;
  {
    const Unlocked unlocked;
    Span span({0, 0, 0}, {0, 0, 0});
    const Ranking ranked = rank_points(point, count, origin, size, span);
    const int64_t runs = ranked.runs();
    cells.reserve(runs);
    offsets.reserve(runs + 1);
    rows = make_buffer<uint32_t>(count);
    for (int64_t i = 0; i < count; ++i) {
      rows[i] = ranked.row(i);
      if (!ranked.begins(i)) continue;
      cells.push_back(pack(span.restore(ranked.key(i))));
      offsets.push_back(i);
    }
    offsets.push_back(count);
  }
  return nb::make_tuple(give(std::move(cells)), give(std::move(offsets)),
                        give(std::move(rows), {static_cast<size_t>(count)}));
}

nb::tuple gather_points(Doubles positions, Doubles normals, Input rows_wanted, Doubles origin_of, double size) {
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
    const Unlocked unlocked;
    for (int64_t i = 0; i < count; ++i) {
      // Neighbours in space lie anywhere in the file: ask for what comes soon.
      const int64_t soon = 3 * static_cast<int64_t>(rows[std::min(i + AHEAD, count - 1)]);
      fetch(point + soon);
      fetch(normal + soon);
      for (int axis = 0; axis < 3; ++axis) {
        const int64_t from = 3 * static_cast<int64_t>(rows[i]) + axis;
        local[3 * i + axis] = point[from];
        gathered[3 * i + axis] = normal[from];
      }
    }
    centre_points(local.get(), count, origin, size);
  }
  const size_t n = static_cast<size_t>(count);
  return nb::make_tuple(give(std::move(local), {n, 3}), give(std::move(gathered), {n, 3}));
}

nb::tuple count_cells(Doubles positions, Doubles origin_of, double edge) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const double* origin = check<double>(origin_of, "origin", {3});
  check_positive(edge, "edge");
  const int64_t count = rows_of(positions);
  if (!count || count >= UINT32_MAX) refuse("positions: expected 1 to 2^32 - 1 points");
  Large<int64_t> cells, counts;
  Buffer<int64_t> cell_of;
  {
    const Unlocked unlocked;
    Span span({0, 0, 0}, {0, 0, 0});
    const Ranking ranked = rank_points(point, count, origin, edge, span);
    cell_of = make_buffer<int64_t>(count);
    for (int64_t i = 0; i < count; ++i) {
      if (ranked.begins(i)) {
        cells.push_back(pack(span.restore(ranked.key(i))));
        counts.push_back(0);
      }
      ++counts.back();
      cell_of[ranked.row(i)] = static_cast<int64_t>(cells.size()) - 1;
    }
  }
  return nb::make_tuple(give(std::move(cells)), give(std::move(counts)),
                        give(std::move(cell_of), {static_cast<size_t>(count)}));
}

// Put two zeros before each of the lowest 21 bits.
inline uint64_t spread_bits(int64_t value) {
  uint64_t bits = static_cast<uint64_t>(value) & 0x1FFFFF;
  bits = (bits | bits << 32) & 0x1F00000000FFFF;
  bits = (bits | bits << 16) & 0x1F0000FF0000FF;
  bits = (bits | bits << 8) & 0x100F00F00F00F00F;
  bits = (bits | bits << 4) & 0x10C30C30C30C30C3;
  return (bits | bits << 2) & 0x1249249249249249;
}

nb::tuple count_halved(Doubles positions, Doubles origin_of, double cell_size, int64_t depth) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const double* origin = check<double>(origin_of, "origin", {3});
  if (depth < 0 || depth > 20) refuse("depth: expected 0 to 20");
  const double size = std::ldexp(cell_size, -static_cast<int>(depth));
  check_positive(size, "cell_size");
  const int64_t count = rows_of(positions);
  if (!count || count >= UINT32_MAX) refuse("positions: expected 1 to 2^32 - 1 points");
  const int bits = 3 * static_cast<int>(depth);
  const int64_t within = (int64_t{1} << depth) - 1;
  const size_t width = static_cast<size_t>(depth) + 1;
  Large<int64_t> cells, counts;
  Buffer<int64_t> boxes;
  {
    const Unlocked unlocked;
    double corners[6];
    bound(point, count, corners, corners + 3);
    Place bounds[2];
    visit_places(corners, 2, origin, size, [&](int64_t i, const Place& place) {
      for (int axis = 0; axis < 3; ++axis) bounds[i][axis] = place[axis] >> depth;
    });
    const Span span(bounds[0], bounds[1]);
    if (span.bits() + bits > 64) refuse("positions: they lie in too many cells");
    // By cell, and there by the boxes: what is in a box of any size is one run.
    Ranking ranked(count, span.bits() + bits);
    visit_places(point, count, origin, size, [&](int64_t i, const Place& place) {
      const uint64_t box = spread_bits(place[0] & within) | spread_bits(place[1] & within) << 1 |
                           spread_bits(place[2] & within) << 2;
      ranked.add(i, span.squeeze({place[0] >> depth, place[1] >> depth, place[2] >> depth}) << bits | box);
    });
    ranked.sort();
    Large<int64_t> begun;  // (c, depth + 1): boxes that no box of twice the edge begins with
    for (int64_t i = 0; i < count; ++i) {
      const uint64_t key = ranked.key(i), differs = i ? key ^ ranked.key(i - 1) : 0;
      if (!i || differs >> bits) {
        cells.push_back(pack(span.restore(key >> bits)));
        counts.push_back(0);
        begun.resize(begun.size() + width, 0);
        ++begun[begun.size() - width];
      } else if (differs) {
        int64_t level = 0;  // that the boxes of both are halved from
        while (differs >> 3 * (level + 1)) ++level;
        ++begun[begun.size() - 1 - static_cast<size_t>(level)];
      }
      ++counts.back();
    }
    boxes = make_buffer<int64_t>(static_cast<int64_t>(begun.size()));
    for (size_t i = 0; i < begun.size(); ++i) boxes[i] = begun[i] + (i % width ? boxes[i - 1] : 0);
  }
  const size_t rows = cells.size();
  return nb::make_tuple(give(std::move(cells)), give(std::move(counts)), give(std::move(boxes), {rows, width}));
}

Output<int64_t> sum_neighbours(Integers cells, Integers values, Integers wanted) {
  const int64_t* keys = check_keys(cells, "cells");
  const int64_t count = rows_of(cells);
  const int64_t* value = check<int64_t>(values, "values", {count, ANY});
  const int64_t* rows = check_rows(wanted, "wanted", count);
  const int64_t width = static_cast<int64_t>(values.shape(1)), asked = rows_of(wanted);
  Buffer<int64_t> sums;
  {
    const Unlocked unlocked;
    sums = make_buffer<int64_t>(asked * width);
    std::fill(sums.get(), sums.get() + asked * width, 0);
    Neighbourhood around(keys, count);
    for (int64_t i = 0; i < asked; ++i) {
      const int found = around.gather(keys[rows[i]]);
      for (int cell = 0; cell < found; ++cell)
        for (int64_t column = 0; column < width; ++column)
          // Unsigned, so that absurd values wrap as they do in numpy.
          sums[i * width + column] = static_cast<int64_t>(
              static_cast<uint64_t>(sums[i * width + column]) +
              static_cast<uint64_t>(value[around.rows[cell] * width + column]));
    }
  }
  return give(std::move(sums), {static_cast<size_t>(asked), static_cast<size_t>(width)});
}

}  // namespace

void find_places(const double* points, int64_t count, const double* origin, double size, Place* places) {
  visit_places(points, count, origin, size, [&](int64_t i, const Place& place) { places[i] = place; });
}

HPC_CLONES void centre_points(double* points, int64_t count, const double* origin, double size) {
  constexpr int WIDTH = 24;
  double corner[WIDTH];
  for (int i = 0; i < WIDTH; ++i) corner[i] = origin[i % 3];
  for (int64_t at = 0; at < 3 * count; at += WIDTH) {
    double* some = points + at;
    const int width = static_cast<int>(std::min<int64_t>(WIDTH, 3 * count - at));
    HPC_LANES
    for (int i = 0; i < width; ++i) {
      const double place = (some[i] - corner[i]) / size;
      some[i] = place - std::floor(place) - 0.5;
    }
  }
}

HPC_KERNELS {
  module.def("count_boxes", &count_boxes, "positions"_a, "low"_a, "edge"_a, "one_in"_a);
  module.def("sample_boxes", &sample_boxes, "positions"_a, "low"_a, "edge"_a, "one_in"_a);
  module.def("count_halved", &count_halved, "positions"_a, "origin"_a, "cell_size"_a, "depth"_a);
  module.def("sort_points", &sort_points, "positions"_a, "origin"_a, "cell_size"_a);
  module.def("gather_points", &gather_points, "positions"_a, "normals"_a, "rows"_a, "origin"_a, "cell_size"_a);
  module.def("count_cells", &count_cells, "positions"_a, "low"_a, "edge"_a);
  module.def("sum_neighbours", &sum_neighbours, "keys"_a, "values"_a, "wanted"_a);
}

}  // namespace hpc
