// Arranged points in 24 bytes each: sorted into the blocks of a cloud, and read out of them.
#include <cmath>

#include "clones.h"
#include "families.h"

namespace hpc {
namespace {

constexpr int RECORD = 6;  // offset within the block, normal

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
    nb::gil_scoped_release unlocked;
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
        record[axis] = static_cast<float>(place - std::floor(place));
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
    nb::gil_scoped_release unlocked;
    for (int64_t block = 0, at = 0; block < packed.blocks; at += packed.counts[block++])
      unpack_block(packed.records + RECORD * at, packed.counts[block], packed.corners + 3 * block, edge,
                   positions.get() + 3 * at, normals.get() + 3 * at);
  }
  const size_t count = static_cast<size_t>(packed.points);
  return nb::make_tuple(give(std::move(positions), {count, 3}), give(std::move(normals), {count, 3}));
}

nb::tuple unpack_within(Input records_of, Input counts_of, Input corners_of, double edge, Input low_of, Input high_of) {
  const Packed packed(records_of, counts_of, corners_of, edge);
  const double *low = check<double>(low_of, "low", {3}), *high = check<double>(high_of, "high", {3});
  auto positions = make_buffer<double>(3 * packed.points);
  auto rows = make_buffer<int64_t>(packed.points);
  int64_t found = 0;
  {
    nb::gil_scoped_release unlocked;
    int64_t at = 0;
    for (int64_t block = 0; block < packed.blocks; ++block) {
      const double* corner = packed.corners + 3 * block;
      for (const int64_t stop = at + packed.counts[block]; at < stop; ++at) {
        double* position = positions.get() + 3 * found;
        bool within = true;
        for (int axis = 0; axis < 3; ++axis) {
          position[axis] = static_cast<double>(packed.records[RECORD * at + axis]) * edge + corner[axis];
          within = within && position[axis] >= low[axis] && position[axis] <= high[axis];
        }
        rows[found] = at;
        found += within;  // what does not count is written over
      }
    }
  }
  const size_t count = static_cast<size_t>(found);
  return nb::make_tuple(give(std::move(positions), {count, 3}), give(std::move(rows), {count}));
}

nb::tuple unpack_cells(Input records_of, Input counts_of, Input corners_of, double edge, Input origin_of, double size,
                       Input cells_of, Input groups_of) {
  const Packed packed(records_of, counts_of, corners_of, edge);
  const double* origin = check<double>(origin_of, "origin", {3});
  check_positive(size, "cell_size");
  const int64_t* cells = check_keys(cells_of, "cells");
  const int64_t known = rows_of(cells_of);
  const uint8_t* groups = check<uint8_t>(groups_of, "groups", {known});
  auto positions = make_buffer<double>(3 * packed.points), normals = make_buffer<double>(3 * packed.points);
  auto numbers = make_buffer<uint8_t>(packed.points);
  int64_t found = 0;
  {
    nb::gil_scoped_release unlocked;
    const KeyRows table(cells, known);
    int64_t most = 0;
    for (int64_t block = 0; block < packed.blocks; ++block) most = std::max(most, packed.counts[block]);
    auto rows = make_buffer<uint32_t>(most);
    for (int64_t block = 0, at = 0; block < packed.blocks; at += packed.counts[block++]) {
      // Unpacked to where they stay if they are wanted, and then moved together.
      double *position = positions.get() + 3 * found, *normal = normals.get() + 3 * found;
      const int64_t count = packed.counts[block];
      unpack_block(packed.records + RECORD * at, count, packed.corners + 3 * block, edge, position, normal);
      find_rows(position, count, origin, size, table, rows.get());
      int64_t kept = 0;
      for (int64_t i = 0; i < count; ++i) {
        if (rows[i] >= known) continue;
        if (kept < i) {
          std::copy_n(position + 3 * i, 3, position + 3 * kept);
          std::copy_n(normal + 3 * i, 3, normal + 3 * kept);
        }
        numbers[found + kept++] = groups[rows[i]];
      }
      found += kept;
    }
  }
  const size_t count = static_cast<size_t>(found);
  return nb::make_tuple(give(std::move(positions), {count, 3}), give(std::move(normals), {count, 3}),
                        give(std::move(numbers), {count}));
}

}  // namespace

void bind_packing(nb::module_& module) {
  module.def("pack_records", &pack_records);
  module.def("unpack_records", &unpack_records);
  module.def("unpack_within", &unpack_within);
  module.def("unpack_cells", &unpack_cells);
}

}  // namespace hpc
