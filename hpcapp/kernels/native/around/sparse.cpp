// How crowded it is around points, and which points are nearest to them (see around/sparse.py).
#include <limits>
#include <map>
#include <utility>

#include "arrays.h"
#include "lattice/keys.h"
#include "threads.h"

namespace hpc {
namespace {

// Points by their cells, copied into that order: what is near is read in one go.
struct SortedPoints {
  const int64_t* keys;
  int64_t cells;
  const int64_t* offsets;
  const uint32_t* rows;
  Large<double> position;

  // The points in the cells of a column, `rings` cells up and down from `middle`.
  template <class Lookup>
  std::pair<int64_t, int64_t> column(int64_t middle, int64_t rings, Lookup&& lower_bound) const {
    const int64_t first = lower_bound(middle - rings);
    int64_t last = first;
    while (last < cells && keys[last] <= middle + rings) ++last;
    return {offsets[first], offsets[last]};
  }
};

SortedPoints sort_positions(const Doubles& positions, const Integers& cells, const Integers& offsets_of,
                            const Input& rows_in) {
  const double* position = check<double>(positions, "positions", {ANY, 3});
  const int64_t points = rows_of(positions);
  SortedPoints sorted{check_keys(cells, "keys"), rows_of(cells), nullptr, nullptr, {}};
  sorted.offsets = check_offsets(offsets_of, sorted.cells, points);
  sorted.rows = check<uint32_t>(rows_in, "rows", {points});
  sorted.position.resize(static_cast<size_t>(3 * points));
  for (int64_t at = 0; at < points; ++at) {
    if (sorted.rows[at] >= points) refuse("rows: a row is out of range");
    std::copy_n(position + 3 * static_cast<int64_t>(sorted.rows[at]), 3, &sorted.position[static_cast<size_t>(3 * at)]);
  }
  return sorted;
}

inline double square_between(const double* a, const double* b) {
  const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return x * x + y * y + z * z;
}

Output<bool> find_sparse(Doubles positions, Integers cells, Integers offsets, Input rows, Doubles radii_of,
                         int64_t enough, int64_t threads) {
  const double* radii = check<double>(radii_of, "radii", {rows_of(cells)});
  const int workers = check_threads(threads);
  const SortedPoints sorted = sort_positions(positions, cells, offsets, rows);
  const int64_t points = rows_of(positions);
  Buffer<bool> sparse;
  {
    const Unlocked unlocked;
    sparse = make_buffer<bool>(points);
    run_ranges(sorted.cells, workers, [&](int64_t start, int64_t stop) {
      std::vector<Finger> fingers(9, Finger(sorted.keys, sorted.cells));
      std::pair<int64_t, int64_t> near[9];
      const int order[9] = {4, 1, 3, 5, 7, 0, 2, 6, 8};  // the cell's own column first
      for (int64_t cell = start; cell < stop; ++cell) {
        for (int i = 0; i < 9; ++i) {
          const int64_t middle = sorted.keys[cell] + (order[i] / 3 - 1) * STRIDES[0] + (order[i] % 3 - 1) * STRIDES[1];
          near[i] = sorted.column(middle, 1, [&](int64_t key) { return fingers[static_cast<size_t>(i)].lower_bound(key); });
        }
        const double square = radii[cell] * radii[cell];
        for (int64_t at = sorted.offsets[cell]; at < sorted.offsets[cell + 1]; ++at) {
          const double* own = &sorted.position[static_cast<size_t>(3 * at)];
          int64_t held = -1;  // the point itself
          for (int i = 0; i < 9 && held < enough; ++i)
            for (int64_t other = near[i].first; other < near[i].second && held < enough; ++other)
              held += square_between(own, &sorted.position[static_cast<size_t>(3 * other)]) <= square;
          sparse[sorted.rows[at]] = held < enough;
        }
      }
    });
  }
  return give(std::move(sparse), {static_cast<size_t>(points)});
}

using Near = std::pair<double, int64_t>;  // squared distance, row: sorted so, ties too

// Finds the points nearest to points that come cell by cell.
class Nearest {
 public:
  Nearest(const SortedPoints& sorted, int64_t count) : sorted_(sorted), most_(static_cast<size_t>(count)) {}

  // Find those in the cells around a cell, up to so many cells away, but for the point itself.
  void find(int64_t key, int64_t rings, int64_t itself, double square) {
    auto& fingers = fingers_[rings];
    if (fingers.empty()) fingers.assign(static_cast<size_t>((2 * rings + 1) * (2 * rings + 1)), {sorted_.keys, sorted_.cells});
    found.clear();
    const double* from = &sorted_.position[static_cast<size_t>(3 * itself)];
    auto finger = fingers.begin();
    const auto outwards = [](int64_t step) { return step % 2 ? step / 2 + 1 : -(step / 2); };  // 0, 1, -1, 2, -2 ...
    for (int64_t i = 0; i <= 2 * rings; ++i)
      for (int64_t j = 0; j <= 2 * rings; ++j, ++finger) {
        const auto [first, last] = sorted_.column(key + outwards(i) * STRIDES[0] + outwards(j) * STRIDES[1], rings,
                                                  [&](int64_t wanted) { return finger->lower_bound(wanted); });
        for (int64_t at = first; at < last; ++at) {
          const double apart = square_between(from, &sorted_.position[static_cast<size_t>(3 * at)]);
          if (apart <= square && at != itself && take({apart, sorted_.rows[at]})) square = found.back().first;
        }
      }
  }

  bool is_full() const { return found.size() == most_; }

  std::vector<Near> found;  // sorted

 private:
  // Put a point in its place, and tell whether there are enough.
  bool take(const Near& one) {
    if (!is_full())
      found.push_back(one);
    else if (one < found.back())
      found.back() = one;
    else
      return true;
    size_t at = found.size() - 1;
    for (; at && one < found[at - 1]; --at) found[at] = found[at - 1];
    found[at] = one;
    return is_full();
  }

  const SortedPoints& sorted_;
  size_t most_;
  std::map<int64_t, std::vector<Finger>> fingers_;  // by rings, one for each column of cells
};

nb::tuple find_nearest(Doubles positions, Integers cells, Integers offsets, Input rows, double edge, Integers asked_of,
                       int64_t count, double limit, int64_t threads) {
  const SortedPoints sorted = sort_positions(positions, cells, offsets, rows);
  const int64_t points = rows_of(positions), wanted = rows_of(asked_of);
  const int64_t* asked = check<int64_t>(asked_of, "asked", {ANY});
  for (int64_t i = 0; i < wanted; ++i)
    if (asked[i] < 0 || asked[i] >= points) refuse("asked: a row is out of range");
  check_positive(edge, "edge");
  check_positive(limit, "limit");
  if (count < 1 || count > 1024) refuse("count: expected 1 to 1024");
  if (!(limit / edge <= 64.0)) refuse("limit: expected 64 edges at most");
  const int workers = check_threads(threads);
  const int64_t most = std::max<int64_t>(1, static_cast<int64_t>(std::ceil(limit / edge)));
  Buffer<double> squares;
  Buffer<int64_t> nearest;
  {
    const Unlocked unlocked;
    squares = make_buffer<double>(wanted * count);
    nearest = make_buffer<int64_t>(wanted * count);
    std::fill_n(squares.get(), wanted * count, std::numeric_limits<double>::infinity());
    std::fill_n(nearest.get(), wanted * count, points);
    Large<uint32_t> place(static_cast<size_t>(points));
    for (int64_t at = 0; at < points; ++at) place[sorted.rows[at]] = static_cast<uint32_t>(at);
    Large<std::pair<uint32_t, uint32_t>> order(static_cast<size_t>(wanted));  // cell by cell
    for (int64_t i = 0; i < wanted; ++i) order[i] = {place[static_cast<size_t>(asked[i])], static_cast<uint32_t>(i)};
    std::sort(order.begin(), order.end());
    run_ranges(wanted, workers, [&](int64_t start, int64_t stop) {
      Nearest near(sorted, count);
      for (int64_t one = start; one < stop; ++one) {
        const auto [at, i] = order[static_cast<size_t>(one)];
        const int64_t* after = std::upper_bound(sorted.offsets, sorted.offsets + sorted.cells, int64_t{at});
        const int64_t key = sorted.keys[after - sorted.offsets - 1];
        for (int64_t rings = 1;; rings = std::min(2 * rings, most)) {
          // All that is no farther than `rings` cells was met, and more at the corners.
          const double reach = std::min(limit, static_cast<double>(rings) * edge);
          near.find(key, rings, at, reach * reach);
          if (near.is_full() || rings >= most) break;
        }
        for (size_t k = 0; k < near.found.size(); ++k) {
          squares[i * count + static_cast<int64_t>(k)] = near.found[k].first;
          nearest[i * count + static_cast<int64_t>(k)] = near.found[k].second;
        }
      }
    });
  }
  const std::initializer_list<size_t> shape = {static_cast<size_t>(wanted), static_cast<size_t>(count)};
  return nb::make_tuple(give(std::move(squares), shape), give(std::move(nearest), shape));
}

}  // namespace

HPC_KERNELS {
  module.def("find_sparse", &find_sparse, "positions"_a, "keys"_a, "offsets"_a, "rows"_a, "radii"_a, "enough"_a,
             "threads"_a = 1);
  module.def("find_nearest", &find_nearest, "positions"_a, "keys"_a, "offsets"_a, "rows"_a, "edge"_a, "asked"_a,
             "count"_a, "limit"_a, "threads"_a = 1);
}

}  // namespace hpc
