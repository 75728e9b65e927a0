#include "strides.h"

#include <nanobind/stl/array.h>

namespace hpc {
namespace {

void take_strides(nb::handle given, Strides& strides) {
  const auto record = field_of<nb::object>(given, "strides");
  if (record.is_none()) return;
  strides.differ = true;
  strides.keys_of = field_of<Integers>(record, "keys");
  strides.exponents_of = field_of<Bytes>(record, "exponents");
  strides.keys = check_keys(strides.keys_of, "keys");
  strides.count = rows_of(strides.keys_of);
  strides.exponents = check<uint8_t>(strides.exponents_of, "exponents", {strides.count});
  for (int64_t i = 0; i < strides.count; ++i)
    if (strides.exponents[i] > MOST_SHIFT) refuse("exponents: expected 0 to 3");
  const auto rest = field_of<int64_t>(record, "rest");
  if (rest < 0 || rest > MOST_SHIFT) refuse("rest: expected 0 to 3");
  strides.rest = static_cast<uint8_t>(rest);
}

}  // namespace

Grid take_grid(nb::handle given) {
  Grid grid;
  const auto origin = field_of<Doubles>(given, "origin");
  std::copy_n(check<double>(origin, "origin", {3}), 3, grid.origin);
  check_finite(grid.origin, 3, "origin");
  grid.step = field_of<double>(given, "step");
  check_positive(grid.step, "step");
  const auto bricks = field_of<std::array<int64_t, 3>>(given, "bricks");
  for (int axis = 0; axis < 3; ++axis) {
    if (bricks[axis] < 1 || bricks[axis] > 2048) refuse("bricks: expected 1 to 2048 along each axis");
    grid.bricks[axis] = bricks[axis];
  }
  take_strides(given, grid.strides);
  return grid;
}

LineShifts line_shifts(const Grid& grid, const Place& place) {
  LineShifts lines;
  if (!grid.strides.differ) return lines;
  // The strides of the bricks around; those off the grid do not count.
  uint8_t(&at)[3][3][3] = lines.at;
  const auto is_there = [&](int axis, int step) {
    const int64_t layer = place[axis] + step - 1;
    return layer >= 0 && layer < grid.bricks[axis];
  };
  for (int x = 0; x < 3; ++x)
    for (int y = 0; y < 3; ++y) {
      std::fill_n(at[x][y], 3, uint8_t{MOST_SHIFT});
      if (!is_there(0, x) || !is_there(1, y)) continue;
      grid.strides.around(pack({place[0] + x - 1, place[1] + y - 1, place[2]}), at[x][y]);
      for (int z = 0; z < 3; z += 2)
        if (!is_there(2, z)) at[x][y][z] = MOST_SHIFT;
    }
  // Each end of an axis is the finer one of two bricks, one axis after the other.
  const uint8_t own = lines.own();
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b)
      for (int end = 0; end < 3; end += 2) at[end][a][b] = std::min(at[end][a][b], at[1][a][b]);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b)
      for (int end = 0; end < 3; end += 2) at[a][end][b] = std::min(at[a][end][b], at[a][1][b]);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b)
      for (int end = 0; end < 3; end += 2) at[a][b][end] = std::min(at[a][b][end], at[a][b][1]);
  for (int corner = 0; corner < 8; ++corner) at[corner & 2][corner << 1 & 2][corner >> 1 & 2] = own;  // no lines
  return lines;
}

void spread_nodes(const float* nodes, const LineShifts& shifts, float* values) {
  const int finest = shifts.finest(), side = shifts.cells() + 1;
  for (int x = 0; x < NODES; ++x)
    for (int y = 0; y < NODES; ++y)
      for (int z = 0; z < NODES; ++z) {
        const int shift = shifts.at[end_of(x)][end_of(y)][end_of(z)];
        const auto below = [&](int place) { return place >> shift << shift >> finest; };
        *values++ = nodes[(below(x) * side + below(y)) * side + below(z)];
      }
}

}  // namespace hpc
