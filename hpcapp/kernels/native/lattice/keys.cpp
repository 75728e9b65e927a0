// Sets of places: all within a box around each, all parents, which lie near something, which touch.
#include <algorithm>
#include <cmath>
#include <deque>
#include <iterator>

#include "arrays.h"
#include "constants.h"
#include "keys.h"
#include "sets.h"
#include "threads.h"

namespace hpc {
namespace {

// A sorted set of keys.
struct Keys {
  Buffer<int64_t> at;
  int64_t count;
};

// Return the union of sorted keys and of the same keys, each moved by a step.
Keys add_shifted(const Keys& keys, int64_t step) {
  Keys both{make_buffer<int64_t>(2 * keys.count), 0};
  const int64_t* at = keys.at.get();
  int64_t i = 0, j = 0, found = 0;
  while (i < keys.count) {
    const int64_t own = at[i], moved = at[j] + step;  // the keys that are moved come last
    both.at[found++] = std::min(own, moved);
    i += own <= moved;
    j += moved <= own;
  }
  for (; j < keys.count; ++j) both.at[found++] = at[j] + step;
  both.count = found;
  return both;
}

// Return the union of sorted keys, each moved by `low` to `high` steps.
Keys spread_axis(Keys keys, int64_t step, int64_t low, int64_t high) {
  for (int64_t i = 0; i < keys.count; ++i) keys.at[i] += low * step;
  for (int64_t width = 1; width <= high - low;) {
    const int64_t more = std::min(width, high - low + 1 - width);
    keys = add_shifted(keys, more * step);
    width += more;
  }
  return keys;
}

// The keys of one x, spread along y and z: without their x.
struct Layer {
  int64_t x;
  Keys keys;
};

Layer spread_layer(const int64_t* keys, int64_t count, int64_t low, int64_t high) {
  const int64_t x = keys[0] / STRIDES[0];
  Keys spread{make_buffer<int64_t>(count), count};
  for (int64_t i = 0; i < count; ++i) spread.at[i] = keys[i] - x * STRIDES[0];
  for (int axis = 2; axis >= 1; --axis) spread = spread_axis(std::move(spread), STRIDES[axis], low, high);
  return {x, std::move(spread)};
}

// Append the union of some layers, at one x. `united` and `more` are room for it.
void unite_layers(const std::deque<Layer>& layers, int64_t x, std::vector<int64_t>& united,
                  std::vector<int64_t>& more, Large<int64_t>& spread) {
  united.clear();
  for (const Layer& layer : layers) {
    const int64_t* at = layer.keys.at.get();
    more.clear();
    std::set_union(united.begin(), united.end(), at, at + layer.keys.count, std::back_inserter(more));
    std::swap(united, more);
  }
  for (const int64_t key : united) spread.push_back(x * STRIDES[0] + key);
}

// One x after the other, as keys sort: what it takes beside the result is some layers.
Large<int64_t> spread_sorted(const int64_t* keys, int64_t count, int64_t low, int64_t high) {
  Large<int64_t> spread;
  spread.reserve(static_cast<size_t>(4 * count));  // so many where a surface is spread by four
  std::deque<Layer> near;
  std::vector<int64_t> united, more;
  int64_t next = 0;
  for (int64_t x = 0; next < count || !near.empty(); ++x) {
    poll();
    if (near.empty()) x = keys[next] / STRIDES[0] + low;
    while (next < count && keys[next] / STRIDES[0] + low <= x) {
      const int64_t end = (keys[next] / STRIDES[0] + 1) * STRIDES[0];
      const int64_t* stop = std::lower_bound(keys + next, keys + count, end);
      near.push_back(spread_layer(keys + next, stop - keys - next, low, high));
      next = stop - keys;
    }
    unite_layers(near, x, united, more, spread);
    while (!near.empty() && near.front().x + high <= x) near.pop_front();
  }
  return spread;
}

Output<int64_t> spread_keys(Integers keys_of, int64_t low, int64_t high) {
  const int64_t* keys = check_keys(keys_of, "keys");
  if (low > high || low < -8 || high > 8) refuse("low, high: expected -8 <= low <= high <= 8");
  Large<int64_t> spread;
  {
    const Unlocked unlocked;
    spread = spread_sorted(keys, rows_of(keys_of), low, high);
  }
  return give(std::move(spread));
}

// Keys that share the coordinate along an axis, and all slower ones.
struct Run {
  int64_t slower, coordinate, start, stop;
};

std::vector<Run> find_runs(const Keys& keys, int64_t stride) {
  std::vector<Run> runs;
  for (int64_t i = 0; i < keys.count; ++i) {
    const int64_t place = keys.at[i] / stride;
    if (!runs.empty() && place == runs.back().slower + runs.back().coordinate) continue;
    if (!runs.empty()) runs.back().stop = i;
    runs.push_back({place & ~MASK, place & MASK, i, keys.count});
  }
  return runs;
}

// Append the union of what the faster coordinates of at most three runs are, after `front`.
void unite_runs(const Keys& keys, const Run* runs, int count, int64_t stride, int64_t front, Keys& united) {
  constexpr int64_t END = INT64_MAX;
  int64_t at[3], head[3] = {END, END, END};
  const auto look = [&](int run) { head[run] = at[run] < runs[run].stop ? keys.at[at[run]] & (stride - 1) : END; };
  for (int run = 0; run < count; ++run) {
    at[run] = runs[run].start;
    look(run);
  }
  for (int64_t least; (least = std::min({head[0], head[1], head[2]})) != END;) {
    united.at[united.count++] = front + least;
    for (int run = 0; run < count; ++run) {
      at[run] += head[run] == least;
      look(run);
    }
  }
}

// Halve one coordinate of each place; one that is odd has two parents. Sorted, unique.
Keys halve_axis(const Keys& keys, int64_t stride) {
  const std::vector<Run> runs = find_runs(keys, stride);
  Keys halved{make_buffer<int64_t>(2 * keys.count), 0};
  for (size_t run = 0; run < runs.size();) {
    const int64_t slower = runs[run].slower;
    const auto in_column = [&](size_t i) { return i < runs.size() && runs[i].slower == slower; };
    for (int64_t half = 0; in_column(run); ++half) {
      half = std::max(half, runs[run].coordinate / 2);
      int count = 0;
      while (in_column(run + count) && runs[run + count].coordinate <= 2 * half + 1) ++count;
      unite_runs(keys, &runs[run], count, stride, (slower + half + BIAS / 2) * stride, halved);
      while (in_column(run) && runs[run].coordinate <= 2 * half) ++run;
    }
  }
  return halved;
}

// Halve the fastest coordinate, which leaves the order as it is.
Keys halve_fastest(const int64_t* keys, int64_t count) {
  Keys halved{make_buffer<int64_t>(2 * count), 0};
  for (int64_t i = 0; i < count; ++i) {
    const int64_t slower = keys[i] & ~MASK, place = keys[i] & MASK;
    for (int64_t half = place / 2; half <= (place + 1) / 2; ++half) {
      const int64_t key = slower + half + BIAS / 2;
      if (!halved.count || halved.at[halved.count - 1] != key) halved.at[halved.count++] = key;
    }
  }
  return halved;
}

Output<int64_t> parent_keys(Integers keys_of) {
  const int64_t* keys = check_keys(keys_of, "keys");
  Keys parents{};
  {
    const Unlocked unlocked;
    parents = halve_fastest(keys, rows_of(keys_of));
    for (int axis = 1; axis >= 0; --axis) parents = halve_axis(parents, STRIDES[axis]);
  }
  return give(std::move(parents.at), {static_cast<size_t>(parents.count)});
}

Output<int64_t> find_keys(Integers keys_of, Integers wanted_of, int64_t threads) {
  const int64_t* keys = check_keys(keys_of, "keys");
  const int64_t* wanted = check<int64_t>(wanted_of, "wanted", {ANY});
  const int64_t known = rows_of(keys_of), count = rows_of(wanted_of);
  const int workers = check_threads(threads);
  auto rows = make_buffer<int64_t>(count);
  {
    const Unlocked unlocked;
    run_ranges(count, workers, [&](int64_t start, int64_t stop) {
      Finger finger(keys, known);
      for (int64_t i = start; i < stop; ++i) {
        const int64_t row = finger.find(wanted[i]);
        rows[i] = row < 0 ? known : row;
      }
    });
  }
  return give(std::move(rows), {static_cast<size_t>(count)});
}

Output<uint32_t> mark_ancestors(Integers cells_of, int64_t depth, Integers ancestors_of) {
  const int64_t* cells = check_keys(cells_of, "cells");
  const int64_t* ancestors = check_keys(ancestors_of, "ancestors");
  if (depth < 0 || depth >= BITS) refuse("depth: expected 0 to 20");
  const int64_t count = rows_of(cells_of), known = rows_of(ancestors_of), last = (int64_t{1} << depth) - 1;
  auto marks = make_buffer<uint32_t>(known);
  {
    const Unlocked unlocked;
    std::fill_n(marks.get(), known, 0u);
    Finger finger(ancestors, known);
    for (int64_t i = 0; i < count; ++i) {
      Place place = unpack(cells[i]);
      uint32_t shape = 0;
      for (int axis = 2; axis >= 0; --axis) {
        const int64_t within = place[axis] & last;
        shape = 3 * shape + (within == 0 ? 0 : within == last ? 2 : 1);
        place[axis] >>= depth;
      }
      const int64_t row = finger.find(pack(place));
      if (row >= 0) marks[row] |= 1u << shape;
    }
  }
  return give(std::move(marks), {static_cast<size_t>(known)});
}

// Tell whether a brick of a box may be evaluated, from `first` to before `end`.
bool holds_wanted(const uint8_t* kinds, const int64_t* sides, const int64_t* first, const int64_t* end) {
  for (int64_t x = first[0]; x < end[0]; ++x)
    for (int64_t y = first[1]; y < end[1]; ++y) {
      const uint8_t* row = kinds + (x * sides[1] + y) * sides[2];
      for (int64_t z = first[2]; z < end[2]; ++z)
        if (row[z] != constants::grid::OUT) return true;
    }
  return false;
}

Output<bool> look_near(Integers cells_of, Input origin_of, double size, Bytes kinds_of, Input corner_of, double edge,
                       double reach) {
  const int64_t* cells = check_keys(cells_of, "cells");
  const double* origin = check<double>(origin_of, "origin", {3});
  const uint8_t* kinds = check<uint8_t>(kinds_of, "kinds", {ANY, ANY, ANY});
  const double* corner = check<double>(corner_of, "corner", {3});
  check_finite(origin, 3, "origin");
  check_finite(corner, 3, "corner");
  check_positive(size, "cell_size");
  check_positive(edge, "edge");
  check_positive(reach, "reach");
  const double bricks = reach / edge;
  check_positive(bricks, "reach by edge");
  int64_t sides[3];
  for (size_t axis = 0; axis < 3; ++axis) sides[axis] = static_cast<int64_t>(kinds_of.shape(axis));
  const int64_t count = rows_of(cells_of);
  auto near = make_buffer<bool>(count);
  {
    const Unlocked unlocked;
    for (int64_t i = 0; i < count; ++i) {
      const Place place = unpack(cells[i]);
      int64_t first[3], end[3];
      for (int axis = 0; axis < 3; ++axis) {
        const double column = (origin[axis] + size * (static_cast<double>(place[axis]) + 0.5) - corner[axis]) / edge;
        const double most = static_cast<double>(sides[axis]);
        first[axis] = static_cast<int64_t>(std::clamp(std::floor(column - bricks), 0.0, most));
        end[axis] = static_cast<int64_t>(std::clamp(std::floor(column + bricks) + 1.0, 0.0, most));
      }
      near[i] = holds_wanted(kinds, sides, first, end);
    }
  }
  return give(std::move(near), {static_cast<size_t>(count)});
}

Output<int64_t> unite_keys(Integers first_of, Integers second_of) {
  const int64_t* first = check_keys(first_of, "first");
  const int64_t* second = check_keys(second_of, "second");
  const int64_t count = rows_of(first_of), others = rows_of(second_of);
  auto both = make_buffer<int64_t>(count + others);
  int64_t* end;
  {
    const Unlocked unlocked;
    end = std::set_union(first, first + count, second, second + others, both.get());
  }
  const size_t size = static_cast<size_t>(end - both.get());
  return give(std::move(both), {size});
}

// Disjoint ranges of keys, in their order: what lies in boxes around cells is long rows.
struct Ranges {
  Buffer<int64_t> first, last;
  int64_t count = 0;

  explicit Ranges(int64_t most) : first(make_buffer<int64_t>(most)), last(make_buffer<int64_t>(most)) {}

  // Add a range that begins no earlier than the one before.
  void add(int64_t from, int64_t to) {
    if (count && from <= last[count - 1] + 1) {
      last[count - 1] = std::max(last[count - 1], to);
      return;
    }
    first[count] = from;
    last[count++] = to;
  }
};

// Return the union of ranges and of the same ranges, each moved by a step.
Ranges add_moved(const Ranges& ranges, int64_t step) {
  Ranges both(2 * ranges.count);
  for (int64_t i = 0, j = 0; j < ranges.count;) {
    if (i < ranges.count && ranges.first[i] <= ranges.first[j] + step) {
      both.add(ranges.first[i], ranges.last[i]);
      ++i;
    } else {
      both.add(ranges.first[j] + step, ranges.last[j] + step);
      ++j;
    }
  }
  return both;
}

Output<bool> mark_near(Integers keys_of, Integers cells_of, Input low_of, Input high_of) {
  const int64_t* keys = check_keys(keys_of, "keys");
  const int64_t* cells = check_keys(cells_of, "cells");
  const int64_t* low = check<int64_t>(low_of, "low", {3});
  const int64_t* high = check<int64_t>(high_of, "high", {3});
  const int64_t count = rows_of(cells_of), asked = rows_of(keys_of);
  int64_t reach = 1;
  for (int axis = 0; axis < 3; ++axis) {
    if (low[axis] < 0 || low[axis] > 4096 || high[axis] < 0 || high[axis] > 4096)
      refuse("low, high: expected 0 to 4096");
    reach += high[axis] * STRIDES[axis];
  }
  if (count && cells[count - 1] > INT64_MAX - reach) refuse("cells: expected boxes that end within the lattice");
  auto near = make_buffer<bool>(asked);
  {
    const Unlocked unlocked;
    Ranges ranges(count);
    for (int64_t i = 0; i < count; ++i) ranges.add(cells[i] - low[2], cells[i] + high[2]);
    for (int axis = 1; axis >= 0; --axis) {
      for (int64_t i = 0; i < ranges.count; ++i) {
        ranges.first[i] -= low[axis] * STRIDES[axis];
        ranges.last[i] -= low[axis] * STRIDES[axis];
      }
      const int64_t places = low[axis] + high[axis] + 1;
      for (int64_t width = 1; width < places;) {
        const int64_t more = std::min(width, places - width);
        ranges = add_moved(ranges, more * STRIDES[axis]);
        width += more;
      }
    }
    for (int64_t i = 0, at = 0; i < asked; ++i) {
      while (at < ranges.count && ranges.last[at] < keys[i]) ++at;
      near[i] = at < ranges.count && ranges.first[at] <= keys[i];
    }
  }
  return give(std::move(near), {static_cast<size_t>(asked)});
}

nb::tuple label_cells(Integers cells_of) {
  const int64_t* cells = check_keys(cells_of, "cells");
  const int64_t count = rows_of(cells_of);
  auto label = make_buffer<int32_t>(count);
  int32_t pieces = 0;
  {
    const Unlocked unlocked;
    Sets sets(count);
    const auto join = [&](int64_t step) {
      Finger finger(cells, count);
      for (int64_t i = 0; i < count; ++i) {
        const int64_t row = finger.find(cells[i] + step);
        if (row >= 0) sets.join(static_cast<int32_t>(i), static_cast<int32_t>(row));
      }
    };
    for (int64_t x = 0; x <= 1; ++x)
      for (int64_t y = -x; y <= 1; ++y)
        for (int64_t z = x || y ? -1 : 1; z <= 1; ++z) join(x * STRIDES[0] + y * STRIDES[1] + z * STRIDES[2]);
    pieces = sets.number(label.get());
  }
  return nb::make_tuple(pieces, give(std::move(label), {static_cast<size_t>(count)}));
}

}  // namespace

HPC_KERNELS {
  module.def("spread_keys", &spread_keys, "keys"_a, "low"_a, "high"_a);
  module.def("parent_keys", &parent_keys, "vertices"_a);
  module.def("find_keys", &find_keys, "keys"_a, "wanted"_a, "threads"_a = 1);
  module.def("unite_keys", &unite_keys, "first"_a, "second"_a);
  module.def("mark_ancestors", &mark_ancestors, "cells"_a, "depth"_a, "ancestors"_a);
  module.def("look_near", &look_near, "cells"_a, "origin"_a, "cell_size"_a, "kinds"_a, "corner"_a, "edge"_a,
             "reach"_a);
  module.def("mark_near", &mark_near, "keys"_a, "cells"_a, "low"_a, "high"_a);
  module.def("label_cells", &label_cells, "keys"_a);
}

}  // namespace hpc
