// How far the cells of a dense lattice are from those that are occupied (see lattice/distances.py).
#include <algorithm>
#include <cmath>
#include <limits>

#include "arrays.h"
#include "threads.h"

namespace hpc {
namespace {

constexpr int64_t NOWHERE = int64_t{1} << 50;  // squared: farther than any cell
constexpr int64_t LONGEST = 1 << 20;

// Squared distances along lines of cells: axis after axis, each least sum with the square of the way.
class LineMinima {
 public:
  explicit LineMinima(int64_t length) : value_(length), bottom_(length), from_(length) {}

  // Make each value of a line the least of value[j] + (i - j)^2: the lower envelope of parabolas.
  void take(double* squares, int64_t length, int64_t stride) {
    int64_t last = -1;
    for (int64_t i = 0; i < length; ++i) {
      value_[i] = static_cast<int64_t>(squares[i * stride]);
      if (value_[i] == NOWHERE) continue;
      int64_t from = 0;
      for (; last >= 0; --last) {
        from = meet(bottom_[last], i);
        if (from > from_[last]) break;
      }
      ++last;
      bottom_[last] = i;
      from_[last] = last ? from : -1;
    }
    if (last < 0) return;
    for (int64_t i = 0, at = 0; i < length; ++i) {
      while (at < last && from_[at + 1] < i) ++at;
      const int64_t way = i - bottom_[at];
      squares[i * stride] = static_cast<double>(value_[bottom_[at]] + way * way);
    }
  }

 private:
  // Return the last cell up to which the parabola of `a` is no higher than that of `b` after it.
  int64_t meet(int64_t a, int64_t b) const {
    const int64_t rise = value_[b] - value_[a] + b * b - a * a, run = 2 * (b - a);
    return rise >= 0 ? rise / run : -((-rise + run - 1) / run);
  }

  std::vector<int64_t> value_, bottom_, from_;
};

Output<double> measure_distances(Input occupied_of, int64_t threads) {
  const bool* occupied = check<bool>(occupied_of, "occupied", {ANY, ANY, ANY});
  const int64_t sides[3] = {rows_of(occupied_of), static_cast<int64_t>(occupied_of.shape(1)),
                            static_cast<int64_t>(occupied_of.shape(2))};
  const int workers = check_threads(threads);
  const int64_t longest = *std::max_element(sides, sides + 3);
  if (longest > LONGEST) refuse("occupied: too many cells along a side");
  const int64_t plane = sides[1] * sides[2], count = sides[0] * plane;
  Buffer<double> distances;
  {
    const Unlocked unlocked;
    distances = make_buffer<double>(count);
    run_ranges(count ? sides[0] : 0, workers, [&](int64_t start, int64_t stop) {
      LineMinima minima(longest);
      for (int64_t i = start * plane; i < stop * plane; ++i)
        distances[i] = occupied[i] ? 0.0 : static_cast<double>(NOWHERE);
      for (int64_t x = start; x < stop; ++x) {
        for (int64_t y = 0; y < sides[1]; ++y) minima.take(&distances[x * plane + y * sides[2]], sides[2], 1);
        for (int64_t z = 0; z < sides[2]; ++z) minima.take(&distances[x * plane + z], sides[1], sides[2]);
      }
    });
    run_ranges(sides[0] ? plane : 0, workers, [&](int64_t start, int64_t stop) {
      LineMinima minima(longest);
      for (int64_t line = start; line < stop; ++line) {
        minima.take(&distances[line], sides[0], plane);
        for (int64_t i = line; i < count; i += plane)
          distances[i] = distances[i] == static_cast<double>(NOWHERE) ? std::numeric_limits<double>::infinity()
                                                                      : std::sqrt(distances[i]);
      }
    });
  }
  return give(std::move(distances), {static_cast<size_t>(sides[0]), static_cast<size_t>(sides[1]),
                                     static_cast<size_t>(sides[2])});
}

}  // namespace

HPC_KERNELS {
  module.def("measure_distances", &measure_distances, "occupied"_a, "threads"_a = 1);
}

}  // namespace hpc
