#include "transitions.h"

#include <cstring>
#include <limits>

namespace hpc {
namespace {

int code_of(const Edge& edge) {
  return ((edge.axis * NODES + edge.node[0]) * NODES + edge.node[1]) * NODES + edge.node[2];
}

// Return the number of the cell's edge that an edge is on, `none` where it is on none.
int side_of(const Edge& edge, const int* cell, int size, int none) {
  int number = edge.axis;
  for (int other = 0; other < 3; ++other) {
    if (other == edge.axis) continue;
    const int at = edge.node[other] - cell[other];
    if (at != 0 && at != size) return none;
    number = 2 * number + (at != 0);
  }
  return number;
}

}  // namespace

void mark_crossed(Brick& brick, const LineShifts& shifts) {
  std::memset(brick.crossed, 0, sizeof brick.crossed);
  brick.vertices = 0;
  const int every = 1 << shifts.finest();
  for (int axis = 0; axis < 3; ++axis)
    for (int x = 0; x < BRICK; x += every)
      for (int y = 0; y < BRICK; y += every) {
        brick.before[axis][x][y] = static_cast<uint16_t>(brick.vertices);
        for (int z = 0; z < BRICK; z += every) {
          const int node[3] = {x, y, z}, length = 1 << shifts.along(axis, node);
          if ((x | y | z) & (length - 1)) continue;
          int upper[3] = {x, y, z};
          upper[axis] += length;
          if (is_inside(brick, node) == is_inside(brick, upper)) continue;
          brick.crossed[axis][x][y] = static_cast<uint8_t>(brick.crossed[axis][x][y] | 1u << z);
          ++brick.vertices;
        }
      }
}

Transitions::Transitions(const LineShifts& shifts) {
  for (int x = 0; x < 3; ++x)
    for (int y = 0; y < 3; ++y)
      for (int z = 0; z < 3; ++z) {
        finer_[x][y][z] = shifts.at[x][y][z] < shifts.own();
        any_ = any_ || finer_[x][y][z];
      }
}

bool Transitions::at(int x, int y, int z, int size) const {
  if (!any_) return false;
  const int low[3] = {x, y, z};
  int first[3], last[3];
  for (int axis = 0; axis < 3; ++axis) {
    first[axis] = low[axis] == 0 ? 0 : 1;
    last[axis] = low[axis] + size == BRICK ? 2 : 1;
  }
  for (int i = first[0]; i <= last[0]; ++i)
    for (int j = first[1]; j <= last[1]; ++j)
      for (int k = first[2]; k <= last[2]; ++k)
        if (finer_[i][j][k]) return true;
  return false;
}

// Cut off each run of inside nodes on the border of a quad.
void LoopTracer::cross_quad(const Brick& brick, const LineShifts& shifts, const int (&corners)[4][3], int quad) {
  crossings_.clear();
  for (int side = 0; side < 4; ++side) {
    const int* end = corners[(side + 1) % 4];
    int node[3] = {corners[side][0], corners[side][1], corners[side][2]};
    int axis = 0;
    while (node[axis] == end[axis]) ++axis;
    const int length = 1 << shifts.along(axis, node), step = end[axis] > node[axis] ? length : -length;
    while (node[axis] != end[axis]) {
      const bool was = is_inside(brick, node);
      Edge edge{axis, {node[0], node[1], node[2]}};
      node[axis] += step;
      if (is_inside(brick, node) == was) continue;
      if (step < 0) edge.node[axis] = node[axis];
      crossings_.push_back({edge, !was});
    }
  }
  for (size_t i = 0; i < crossings_.size(); ++i) {
    if (crossings_[i].enters) continue;
    const Crossing& before = crossings_[(i + crossings_.size() - 1) % crossings_.size()];
    row_of_[code_of(crossings_[i].edge)] = static_cast<int>(turns_.size());
    turns_.push_back({crossings_[i].edge, code_of(before.edge), quad});
  }
}

const std::vector<Loop>& LoopTracer::trace(const Brick& brick, const LineShifts& shifts, const int* cell, int size) {
  turns_.clear();
  int quad = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const int b = (axis + 1) % 3, c = (axis + 2) % 3;
    for (int end = 0; end <= size; end += size) {
      int corner[3] = {cell[0], cell[1], cell[2]};
      corner[axis] += end;
      int opposite[3] = {cell[0] + size, cell[1] + size, cell[2] + size};
      opposite[axis] = corner[axis];
      if (!is_crossed(brick, corner, opposite)) continue;
      const int step = 1 << shifts.across(axis, corner);
      const int ahead = end ? b : c, beside = end ? c : b;
      for (int at_b = 0; at_b < size; at_b += step)
        for (int at_c = 0; at_c < size; at_c += step) {
          int corners[4][3];
          for (int i = 0; i < 4; ++i) {
            std::copy_n(corner, 3, corners[i]);
            corners[i][b] += at_b;
            corners[i][c] += at_c;
            corners[i][ahead] += i == 1 || i == 2 ? step : 0;
            corners[i][beside] += i >= 2 ? step : 0;
          }
          cross_quad(brick, shifts, corners, quad++);
        }
    }
  }
  loops_.clear();
  for (const Turn& first : turns_) {
    Loop loop;
    for (int code = code_of(first.edge); row_of_[code] >= 0;) {
      const Turn& turn = turns_[static_cast<size_t>(row_of_[code])];
      row_of_[code] = -1;
      const int none = -1 - static_cast<int>(loop.edges.size());
      loop.edges.push_back(turn.edge);
      loop.quads.push_back(turn.quad);
      loop.sides.push_back(side_of(turn.edge, cell, size, none));
      const int next = (turn.edge.axis + 1) % 3;
      const bool lies_below = turn.edge.node[next] > cell[next];
      loop.owned.push_back(is_inside(brick, turn.edge.node) == lies_below);
      code = turn.next;
    }
    if (loop.edges.size() > 2) loops_.push_back(std::move(loop));
  }
  return loops_;
}

// Measure the diagonals that may be, and the cross products of all pairs along the loop's normal.
void LoopCutter::measure(const Loop& loop, const std::vector<double>& places) {
  const int n = count_;
  const auto at = [&](int i, int axis) {
    return places[static_cast<size_t>(3 * i + axis)] - places[static_cast<size_t>(axis)];
  };
  const auto cross = [&](int i, int j, int axis) {
    const int a = (axis + 1) % 3, b = (axis + 2) % 3;
    return at(i, a) * at(j, b) - at(j, a) * at(i, b);
  };
  double normal[3] = {0.0, 0.0, 0.0}, longest = 0.0;
  for (int i = 0; i < n; ++i)
    for (int axis = 0; axis < 3; ++axis) normal[axis] += cross(i, (i + 1) % n, axis);
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      const double dx = at(i, 0) - at(j, 0), dy = at(i, 1) - at(j, 1), dz = at(i, 2) - at(j, 2);
      const double length = dx * dx + dy * dy + dz * dz;
      longest = std::max(longest, length);
      const int before_i = loop.quads[(i + n - 1) % n], before_j = loop.quads[(j + n - 1) % n];
      const bool is_owned = loop.quads[i] == loop.quads[j] || (loop.owned[i] && loop.owned[j]);
      const bool may_join = before_i != before_j && before_i != loop.quads[j] && loop.quads[i] != before_j &&
                            (loop.sides[i] != loop.sides[j] || is_owned);
      const size_t pair = static_cast<size_t>(i * n + j);
      weights_[pair] = may_join ? length : std::numeric_limits<double>::infinity();
      turns_[pair] = normal[0] * cross(i, j, 0) + normal[1] * cross(i, j, 1) + normal[2] * cross(i, j, 2);
    }
  weights_[static_cast<size_t>(n - 1)] = 0.0;  // which is no diagonal
  penalty_ = n * longest;
}

const std::vector<int>& LoopCutter::cut(const Loop& loop, const std::vector<double>& places) {
  const int n = count_ = static_cast<int>(loop.edges.size());
  const size_t pairs = static_cast<size_t>(n) * static_cast<size_t>(n);
  for (auto* table : {&weights_, &turns_}) table->resize(pairs);
  costs_.assign(pairs, std::numeric_limits<double>::infinity());
  apexes_.resize(pairs);
  measure(loop, places);
  for (int i = 0; i + 1 < n; ++i) costs_[static_cast<size_t>(i * n + i + 1)] = 0.0;
  for (int width = 2; width < n; ++width)
    for (int i = 0; i + width < n; ++i) {
      const int j = i + width;
      const size_t pair = static_cast<size_t>(i * n + j);
      double best = std::numeric_limits<double>::infinity();
      apexes_[pair] = i + 1;
      for (int k = i + 1; k < j; ++k) {
        const size_t left = static_cast<size_t>(i * n + k), right = static_cast<size_t>(k * n + j);
        double total = costs_[left] + costs_[right];
        if (turns_[left] + turns_[right] + turns_[static_cast<size_t>(j * n + i)] <= 0.0) total += penalty_;
        if (total < best) best = total, apexes_[pair] = k;
      }
      costs_[pair] = best + weights_[pair];
    }
  if (!(costs_[static_cast<size_t>(n - 1)] < std::numeric_limits<double>::infinity()))
    refuse("strides: a loop has no triangles that are its own");
  triangles_.clear();
  list(0, n - 1);
  return triangles_;
}

void LoopCutter::list(int i, int j) {
  if (j - i < 2) return;
  const int apex = apexes_[static_cast<size_t>(i * count_ + j)];
  list(i, apex);
  for (int row : {i, j, apex}) triangles_.push_back(row);
  list(apex, j);
}

}  // namespace hpc
