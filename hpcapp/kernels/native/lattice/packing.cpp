// Arranged points in 24 bytes each: sorted into the blocks of a cloud, read out of them, sorted into
// the cells of a tile, and counted in coarse ones.
#include <algorithm>
#include <cmath>
#include <unordered_map>
#include <utility>
#include <vector>

#include "clones.h"
#include "constants.h"
#include "field/strides.h"
#include "points.h"
#include "surface/seeds.h"

namespace hpc {
namespace {

constexpr int RECORD = 6;  // offset within the block, normal
using constants::QUANTA;

nb::tuple pack_records(Input positions_of, Input normals_of, Input origin_of, double edge) {
  const double* positions = check<double>(positions_of, "positions", {ANY, 3});
  const int64_t count = rows_of(positions_of);
  const double* normals = check<double>(normals_of, "normals", {count, 3});
  const double* origin = check<double>(origin_of, "origin", {3});
  check_positive(edge, "edge");
  if (!count || count >= UINT32_MAX) refuse("positions: expected 1 to 2^32 - 1 points");
  Large<int64_t> keys, counts;
  auto records = make_buffer<float>(RECORD * count);
  {
    const Unlocked unlocked;
    Span span({0, 0, 0}, {0, 0, 0});
    const Ranking ranked = rank_points(positions, count, origin, edge, span);
    for (int64_t i = 0; i < count; ++i) {
      if (ranked.begins(i)) {
        keys.push_back(pack(span.restore(ranked.key(i))));
        counts.push_back(0);
      }
      ++counts.back();
      // Neighbours in space lie anywhere in the file: ask for what comes soon.
      const int64_t soon = 3 * static_cast<int64_t>(ranked.row(std::min(i + AHEAD, count - 1)));
      fetch(positions + soon);
      fetch(normals + soon);
      const int64_t from = 3 * static_cast<int64_t>(ranked.row(i));
      float* record = records.get() + RECORD * i;
      for (int axis = 0; axis < 3; ++axis) {
        const double place = (positions[from + axis] - origin[axis]) / edge;
        record[axis] = static_cast<float>((std::floor((place - std::floor(place)) * QUANTA) + 0.5) / QUANTA);
        record[3 + axis] = static_cast<float>(normals[from + axis]);
      }
    }
  }
  return nb::make_tuple(give(std::move(keys)), give(std::move(counts)),
                        give(std::move(records), {static_cast<size_t>(count), RECORD}));
}

// Packed points as they are handed over: block i has its corner, and the next counts[i] records.
struct Packed {
  const float* records;
  const int64_t* counts;
  const double* corners;
  int64_t blocks, points;
  double edge;

  Packed(const Input& records_of, const Input& counts_of, const Input& corners_of, double edge_of)
      : records(check<float>(records_of, "records", {ANY, RECORD})),
        counts(check<int64_t>(counts_of, "counts", {ANY})),
        corners(check<double>(corners_of, "corners", {rows_of(counts_of), 3})),
        blocks(rows_of(counts_of)),
        points(rows_of(records_of)),
        edge(edge_of) {
    check_positive(edge, "edge");
    int64_t left = points;
    for (int64_t i = 0; i < blocks; ++i) {
      if (counts[i] < 0 || counts[i] > left) refuse("counts: they are not those of the records");
      left -= counts[i];
    }
    if (left) refuse("counts: they are not those of the records");
  }
};

HPC_CLONES void unpack_block(const float* records, int64_t count, const double* corner, double edge, double* positions,
                             double* normals) {
  for (int64_t i = 0; i < count; ++i)
    for (int axis = 0; axis < 3; ++axis) {
      positions[3 * i + axis] = static_cast<double>(records[RECORD * i + axis]) * edge + corner[axis];
      normals[3 * i + axis] = records[RECORD * i + 3 + axis];
    }
}

nb::tuple unpack_records(Input records_of, Input counts_of, Input corners_of, double edge) {
  const Packed packed(records_of, counts_of, corners_of, edge);
  auto positions = make_buffer<double>(3 * packed.points), normals = make_buffer<double>(3 * packed.points);
  {
    const Unlocked unlocked;
    for (int64_t block = 0, at = 0; block < packed.blocks; at += packed.counts[block++])
      unpack_block(packed.records + RECORD * at, packed.counts[block], packed.corners + 3 * block, edge,
                   positions.get() + 3 * at, normals.get() + 3 * at);
  }
  const size_t count = static_cast<size_t>(packed.points);
  return nb::make_tuple(give(std::move(positions), {count, 3}), give(std::move(normals), {count, 3}));
}

void unpack_position(const float* record, const double* corner, double edge, double* position) {
  for (int axis = 0; axis < 3; ++axis) position[axis] = static_cast<double>(record[axis]) * edge + corner[axis];
}

nb::tuple unpack_within(Input records_of, Input counts_of, Input corners_of, double edge, Input low_of, Input high_of) {
  const Packed packed(records_of, counts_of, corners_of, edge);
  const double *low = check<double>(low_of, "low", {3}), *high = check<double>(high_of, "high", {3});
  auto positions = make_buffer<double>(3 * packed.points);
  auto rows = make_buffer<int64_t>(packed.points);
  int64_t found = 0;
  {
    const Unlocked unlocked;
    int64_t at = 0;
    for (int64_t block = 0; block < packed.blocks; ++block) {
      const double* corner = packed.corners + 3 * block;
      for (const int64_t stop = at + packed.counts[block]; at < stop; ++at) {
        double* position = positions.get() + 3 * found;
        unpack_position(packed.records + RECORD * at, corner, edge, position);
        bool within = true;
        for (int axis = 0; axis < 3; ++axis)
          within = within && position[axis] >= low[axis] && position[axis] <= high[axis];
        rows[found] = at;
        found += within;  // what does not count is written over
      }
    }
  }
  const size_t count = static_cast<size_t>(found);
  return nb::make_tuple(give(std::move(positions), {count, 3}), give(std::move(rows), {count}));
}

nb::tuple sort_packed(Input records_of, Input counts_of, Input corners_of, double edge, Input origin_of, double size,
                      int64_t depth, Input wanted_of, Input numbers_of) {
  const Packed packed(records_of, counts_of, corners_of, edge);
  if (packed.points >= UINT32_MAX) refuse("records: expected fewer than 2^32 - 1");
  const double* origin = check<double>(origin_of, "origin", {3});
  check_positive(size, "cell_size");
  if (depth < 0 || depth >= BITS) refuse("depth: expected 0 to 20");
  const int64_t* wanted = check_keys(wanted_of, "wanted");
  const int64_t known = rows_of(wanted_of);
  const uint8_t* numbers = check<uint8_t>(numbers_of, "numbers", {known});
  Large<int64_t> cells, offsets;
  Large<uint8_t> groups;
  Buffer<float> records;
  Buffer<uint32_t> blocks;
  size_t kept = 0;
  {
    const Unlocked unlocked;
    const KeyRows table(wanted, known);
    Place low{0, 0, 0}, high{0, 0, 0};  // of the finest cells, as far as the lattice goes
    for (int64_t i = 0; i < known; ++i) {
      const Place place = unpack(wanted[i]);
      for (int axis = 0; axis < 3; ++axis) {
        const int64_t side = int64_t{1} << depth;
        const int64_t first = std::clamp(place[axis] * side, -BIAS, BIAS - 1);
        const int64_t last = std::clamp(place[axis] * side + side - 1, -BIAS, BIAS - 1);
        low[axis] = i ? std::min(low[axis], first) : first;
        high[axis] = i ? std::max(high[axis], last) : last;
      }
    }
    const Span span(low, high);
    const auto find_above = [&](const Place& place) {
      return table.find(pack({place[0] >> depth, place[1] >> depth, place[2] >> depth}));
    };
    Ranking ranked(packed.points, span.bits());
    auto block_of = make_buffer<uint32_t>(packed.points);
    for (int64_t block = 0, at = 0; block < packed.blocks; ++block)
      for (int64_t left = packed.counts[block]; left;) {
        const int64_t width = std::min<int64_t>(POINTS_AT_ONCE, left);
        double positions[3 * POINTS_AT_ONCE];
        Place places[POINTS_AT_ONCE];
        for (int64_t i = 0; i < width; ++i)
          unpack_position(packed.records + RECORD * (at + i), packed.corners + 3 * block, edge, positions + 3 * i);
        find_places(positions, width, origin, size, places);
        for (int64_t i = 0; i < width; ++i, ++at) {
          block_of[at] = static_cast<uint32_t>(block);
          if (find_above(places[i]) < known) ranked.add(at, span.squeeze(places[i]));
        }
        left -= width;
      }
    ranked.sort();
    const int64_t count = ranked.count(), runs = ranked.runs();
    kept = static_cast<size_t>(count);
    cells.reserve(runs);
    groups.reserve(runs);
    offsets.reserve(runs + 1);
    records = make_buffer<float>(RECORD * count);
    blocks = make_buffer<uint32_t>(count);
    for (int64_t i = 0; i < count; ++i) {
      // Neighbours in space lie anywhere in their block: ask for what comes soon.
      fetch(packed.records + RECORD * static_cast<int64_t>(ranked.row(std::min(i + AHEAD, count - 1))));
      const int64_t row = ranked.row(i);
      std::copy_n(packed.records + RECORD * row, RECORD, records.get() + RECORD * i);
      blocks[i] = block_of[row];
      if (!ranked.begins(i)) continue;
      const Place place = span.restore(ranked.key(i));
      cells.push_back(pack(place));
      groups.push_back(numbers[find_above(place)]);
      offsets.push_back(i);
    }
    offsets.push_back(count);
  }
  return nb::make_tuple(give(std::move(cells)), give(std::move(offsets)), give(std::move(records), {kept, RECORD}),
                        give(std::move(blocks), {kept}), give(std::move(groups)));
}

// Count packed points in the occupied cells of a lattice that has few: coarse ones.
nb::tuple count_packed(Input records_of, Input counts_of, Input corners_of, double edge, Input origin_of, double size) {
  const Packed packed(records_of, counts_of, corners_of, edge);
  const double* origin = check<double>(origin_of, "origin", {3});
  check_positive(size, "cell_size");
  Large<int64_t> cells, counts;
  {
    const Unlocked unlocked;
    std::unordered_map<int64_t, int64_t> held;
    int64_t last = -1, *in_last = nullptr;  // points come block by block: mostly in the same cell
    for (int64_t block = 0, at = 0; block < packed.blocks; ++block)
      for (const int64_t stop = at + packed.counts[block]; at < stop;) {
        const int64_t width = std::min<int64_t>(POINTS_AT_ONCE, stop - at);
        double positions[3 * POINTS_AT_ONCE];
        Place places[POINTS_AT_ONCE];
        for (int64_t i = 0; i < width; ++i, ++at)
          unpack_position(packed.records + RECORD * at, packed.corners + 3 * block, edge, positions + 3 * i);
        find_places(positions, width, origin, size, places);
        for (int64_t i = 0; i < width; ++i) {
          const int64_t key = pack(places[i]);
          if (key != last) in_last = &held[last = key];
          ++*in_last;
        }
      }
    std::vector<std::pair<int64_t, int64_t>> sorted(held.begin(), held.end());
    std::sort(sorted.begin(), sorted.end());
    for (const auto& [key, count] : sorted) {
      cells.push_back(key);
      counts.push_back(count);
    }
  }
  return nb::make_tuple(give(std::move(cells)), give(std::move(counts)));
}

// Packed points in any order, each with the row of its block's corner.
struct Scattered {
  const float* records;
  const uint32_t* blocks;
  const double* corners;
  int64_t points;
  double edge;

  Scattered(const Input& records_of, const Input& blocks_of, const Input& corners_of, double edge_of)
      : records(check<float>(records_of, "records", {ANY, RECORD})),
        blocks(check<uint32_t>(blocks_of, "blocks", {rows_of(records_of)})),
        corners(check<double>(corners_of, "corners", {ANY, 3})),
        points(rows_of(records_of)),
        edge(edge_of) {
    check_positive(edge, "edge");
    for (int64_t i = 0; i < points; ++i)
      if (blocks[i] >= rows_of(corners_of)) refuse("blocks: one that is not there");
  }

  void unpack(int64_t row, double* position) const {
    unpack_position(records + RECORD * row, corners + 3 * static_cast<int64_t>(blocks[row]), edge, position);
  }
};

nb::tuple place_packed(Input records_of, Input blocks_of, Input corners_of, double edge, Input origin_of, double size) {
  const Scattered packed(records_of, blocks_of, corners_of, edge);
  const double* origin = check<double>(origin_of, "origin", {3});
  check_positive(size, "cell_size");
  auto local = make_buffer<double>(3 * packed.points), normals = make_buffer<double>(3 * packed.points);
  {
    const Unlocked unlocked;
    for (int64_t i = 0; i < packed.points; ++i) {
      packed.unpack(i, local.get() + 3 * i);
      for (int axis = 0; axis < 3; ++axis) normals[3 * i + axis] = packed.records[RECORD * i + 3 + axis];
    }
    centre_points(local.get(), packed.points, origin, size);
  }
  const size_t count = static_cast<size_t>(packed.points);
  return nb::make_tuple(give(std::move(local), {count, 3}), give(std::move(normals), {count, 3}));
}

Output<int64_t> seed_packed(Input records_of, Input blocks_of, Input corners_of, double edge, Input offsets_of,
                            Input wanted_of, nb::handle grid_of) {
  const Scattered packed(records_of, blocks_of, corners_of, edge);
  const bool* wanted = check<bool>(wanted_of, "wanted", {ANY});
  const int64_t cells = rows_of(wanted_of);
  const int64_t* offsets = check_offsets(offsets_of, cells, packed.points);
  const Grid grid = take_grid(grid_of);
  Large<int64_t> seeds;
  {
    const Unlocked unlocked;
    BrickSet held(grid.bricks);
    double positions[3 * POINTS_AT_ONCE];
    Place places[POINTS_AT_ONCE];
    int width = 0;
    const auto add = [&] {
      find_places(positions, width, grid.origin, BRICK * grid.step, places);
      for (int i = 0; i < width; ++i) held.add(places[i]);
      width = 0;
    };
    for (int64_t cell = 0; cell < cells; ++cell) {
      if (!wanted[cell]) continue;
      for (int64_t row = offsets[cell]; row < offsets[cell + 1]; ++row) {
        packed.unpack(row, positions + 3 * width++);
        if (width == POINTS_AT_ONCE) add();
      }
    }
    add();
    seeds = held.keys();
  }
  return give(std::move(seeds));
}

}  // namespace

HPC_KERNELS {
  module.def("pack_records", &pack_records, "positions"_a, "normals"_a, "origin"_a, "edge"_a);
  module.def("unpack_records", &unpack_records, "records"_a, "counts"_a, "corners"_a, "edge"_a);
  module.def("unpack_within", &unpack_within, "records"_a, "counts"_a, "corners"_a, "edge"_a, "low"_a, "high"_a);
  module.def("sort_packed", &sort_packed, "records"_a, "counts"_a, "corners"_a, "edge"_a, "origin"_a, "cell_size"_a,
             "depth"_a, "wanted"_a, "numbers"_a);
  module.def("count_packed", &count_packed, "records"_a, "counts"_a, "corners"_a, "edge"_a, "origin"_a,
             "cell_size"_a);
  module.def("place_packed", &place_packed, "records"_a, "blocks"_a, "corners"_a, "edge"_a, "origin"_a,
             "cell_size"_a);
  module.def("seed_packed", &seed_packed, "records"_a, "blocks"_a, "corners"_a, "edge"_a, "offsets"_a, "wanted"_a,
             "grid"_a);
}

}  // namespace hpc
