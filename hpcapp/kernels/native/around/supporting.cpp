// Which points support places on a surface, each in a flat ellipsoid around it (see supporting.py).
#include <algorithm>
#include <cmath>
#include <vector>

#include "arrays.h"
#include "constants.h"
#include "lattice/keys.h"
#include "lattice/points.h"
#include "threads.h"

namespace hpc {
namespace {

using constants::supporting::CLASS, constants::supporting::STEPS;

constexpr double ROUNDED = 1.0 + 1e-9;  // of squared distances
constexpr int64_t MOST_WAYS = 64, MOST_ENOUGH = 16;

struct Point {
  double position[3], normal[3], radius, thickness;
};

// Points of like radii by cells as large as their reach, copied into that order.
struct Alike {
  double origin[3], size;
  Large<int64_t> keys, offsets;
  Large<Point> points;
};

struct Cloud {
  Large<Point> points;
  double least, most;  // of the radii
};

Cloud check_cloud(const Doubles& positions, const Doubles& normals, const Doubles& radii_of,
                  const Doubles& thickness_of) {
  const double* position = check<double>(positions, "positions", {ANY, 3});
  const int64_t count = rows_of(positions);
  const double* normal = check<double>(normals, "normals", {count, 3});
  const double* radii = check<double>(radii_of, "radii", {count});
  const double* thickness = check<double>(thickness_of, "thickness", {count});
  if (count >= UINT32_MAX) refuse("positions: expected fewer than 2^32 - 1 points");
  check_finite(position, 3 * count, "positions");
  Cloud cloud{Large<Point>(static_cast<size_t>(count)), INFINITY, 0.0};
  for (int64_t i = 0; i < count; ++i) {
    check_positive(radii[i], "radii");
    check_positive(thickness[i], "thickness");
    if (thickness[i] > radii[i]) refuse("thickness: expected the radius at most");
    Point& point = cloud.points[static_cast<size_t>(i)];
    std::copy_n(position + 3 * i, 3, point.position);
    std::copy_n(normal + 3 * i, 3, point.normal);
    point.radius = radii[i];
    point.thickness = thickness[i];
    cloud.least = std::min(cloud.least, radii[i]);
    cloud.most = std::max(cloud.most, radii[i]);
  }
  return cloud;
}

Alike sort_alike(const Large<Point>& points, double reach) {
  Alike alike;
  const int64_t count = static_cast<int64_t>(points.size());
  Large<double> positions(static_cast<size_t>(3 * count));
  double radius = 0.0;
  for (int64_t i = 0; i < count; ++i) {
    std::copy_n(points[static_cast<size_t>(i)].position, 3, &positions[static_cast<size_t>(3 * i)]);
    radius = std::max(radius, points[static_cast<size_t>(i)].radius);
  }
  std::copy_n(positions.data(), 3, alike.origin);
  alike.size = reach * radius;
  check_positive(alike.size, "radii");
  Span span({0, 0, 0}, {0, 0, 0});
  const Ranking ranked = rank_points(positions.data(), count, alike.origin, alike.size, span);
  alike.points.reserve(static_cast<size_t>(count));
  for (int64_t i = 0; i < count; ++i) {
    alike.points.push_back(points[ranked.row(i)]);
    if (!ranked.begins(i)) continue;
    alike.keys.push_back(pack(span.restore(ranked.key(i))));
    alike.offsets.push_back(i);
  }
  alike.offsets.push_back(count);
  return alike;
}

// Cut points into classes of like radii.
std::vector<Alike> sort_cloud(const Cloud& cloud, double reach) {
  std::vector<Alike> sorted;
  if (cloud.points.empty()) return sorted;
  const auto class_of = [&](double radius) {
    return static_cast<int64_t>((std::log(radius) - std::log(cloud.least)) / std::log(CLASS) + 1e-6);
  };
  std::vector<Large<Point>> classes(static_cast<size_t>(class_of(cloud.most)) + 1);
  for (const Point& point : cloud.points) classes[static_cast<size_t>(class_of(point.radius))].push_back(point);
  for (const auto& points : classes)
    if (!points.empty()) sorted.push_back(sort_alike(points, reach));
  return sorted;
}

// Visits the points of a class around places, of which one is mostly near the last.
class Around {
 public:
  explicit Around(const Alike& alike)
      : alike_(alike), near_(alike.keys.data(), static_cast<int64_t>(alike.keys.size())) {}

  // Call visit(point, along, square) with those within a square; it returns whether to go on.
  template <class Visit>
  bool visit(const double* place, double most, const Visit& visit) {
    Place cell;
    for (int axis = 0; axis < 3; ++axis) {
      const double lower = std::floor((place[axis] - alike_.origin[axis]) / alike_.size);
      // No point is there: those of a class lie on the lattice around the first.
      if (!(lower > -static_cast<double>(BIAS) && lower < static_cast<double>(BIAS) - 1.0)) return true;
      cell[axis] = static_cast<int64_t>(lower);
    }
    if (const int64_t key = pack(cell); key != key_) {
      key_ = key;
      found_ = near_.gather(key);
    }
    for (int i = 0; i < found_; ++i) {
      const int64_t row = near_.rows[i];
      for (int64_t at = alike_.offsets[static_cast<size_t>(row)]; at < alike_.offsets[static_cast<size_t>(row) + 1]; ++at) {
        const Point& point = alike_.points[static_cast<size_t>(at)];
        double arm[3], off = 0.0;
        for (int axis = 0; axis < 3; ++axis) {
          arm[axis] = place[axis] - point.position[axis];
          off += arm[axis] * point.normal[axis];
        }
        // Most are too far away whichever way they face.
        const double apart = arm[0] * arm[0] + arm[1] * arm[1] + arm[2] * arm[2];
        if (apart > ROUNDED * most * (point.radius * point.radius)) continue;
        double along[3];
        for (int axis = 0; axis < 3; ++axis) along[axis] = (arm[axis] - off * point.normal[axis]) / point.radius;
        const double thick = off / point.thickness;
        const double square = along[0] * along[0] + along[1] * along[1] + along[2] * along[2] + thick * thick;
        if (square < most && !visit(point, along, square)) return false;
      }
    }
    return true;
  }

 private:
  const Alike& alike_;
  Neighbourhood near_;
  int64_t key_ = -1;
  int found_ = 0;
};

nb::tuple count_supporting(Doubles places_of, Doubles positions, Doubles normals, Doubles radii, Doubles thickness,
                           int64_t threads) {
  const double* places = check<double>(places_of, "places", {ANY, 3});
  const int64_t wanted = rows_of(places_of);
  const int workers = check_threads(threads);
  const Cloud cloud = check_cloud(positions, normals, radii, thickness);
  Buffer<int64_t> counts;
  Buffer<double> sums;
  {
    const Unlocked unlocked;
    counts = make_buffer<int64_t>(wanted);
    sums = make_buffer<double>(3 * wanted);
    std::fill_n(counts.get(), wanted, 0);
    std::fill_n(sums.get(), 3 * wanted, 0.0);
    const std::vector<Alike> sorted = sort_cloud(cloud, 1.0);
    run_ranges(wanted, workers, [&](int64_t start, int64_t stop) {
      std::vector<Around> around(sorted.begin(), sorted.end());
      for (int64_t i = start; i < stop; ++i)
        for (Around& alike : around)
          alike.visit(places + 3 * i, 1.0, [&](const Point& point, const double*, double) {
            ++counts[i];
            for (int axis = 0; axis < 3; ++axis) sums[3 * i + axis] += std::nearbyint(point.normal[axis] * STEPS);
            return true;
          });
    });
  }
  const size_t rows = static_cast<size_t>(wanted);
  return nb::make_tuple(give(std::move(counts), {rows}), give(std::move(sums), {rows, 3}));
}

// The least squares of the ways from a place.
class Least {
 public:
  Least(int64_t ways, int64_t enough, double least, double most)
      : ways_(ways), enough_(enough), bound_(least), most_(most), held_(static_cast<size_t>(ways * enough)) {}

  void begin() {
    std::fill(held_.begin(), held_.end(), most_);
    open_ = most_ > bound_ ? ways_ : 0;
  }

  // Put the squares of a point among them; return whether one is above the bound still.
  bool lower(const double* ways, const double* along, double square, double step) {
    for (int64_t way = 0; way < ways_; ++way) {
      double aside = 0.0;
      for (int axis = 0; axis < 3; ++axis) aside += ways[3 * way + axis] * along[axis];
      const double here = square + 2.0 * step * aside + step * step;
      double* held = &held_[static_cast<size_t>(way * enough_)];  // rising
      int64_t at = enough_ - 1;
      if (!(here < held[at])) continue;
      const bool was_open = held[at] > bound_;
      for (; at > 0 && here < held[at - 1]; --at) held[at] = held[at - 1];
      held[at] = here;
      open_ -= was_open && !(held[enough_ - 1] > bound_);
    }
    return open_ > 0;
  }

  double largest() const {
    double most = bound_;
    for (int64_t way = 0; way < ways_; ++way)
      most = std::max(most, held_[static_cast<size_t>((way + 1) * enough_ - 1)]);
    return most;
  }

 private:
  int64_t ways_, enough_;
  double bound_, most_;
  Large<double> held_;  // (k, e)
  int64_t open_ = 0;    // ways whose last one is above the bound
};

Output<double> measure_aside(Doubles places_of, Doubles ways_of, Doubles positions, Doubles normals, Doubles radii,
                             Doubles thickness, int64_t enough, double least, double most, int64_t threads) {
  const double* places = check<double>(places_of, "places", {ANY, 3});
  const int64_t wanted = rows_of(places_of);
  const double* ways = check<double>(ways_of, "ways", {wanted, ANY, 3});
  const int64_t number = static_cast<int64_t>(ways_of.shape(1));
  if (number > MOST_WAYS) refuse("ways: expected 64 at most");
  if (enough < 1 || enough > MOST_ENOUGH) refuse("enough: expected 1 to 16");
  check_positive(least, "least");
  check_positive(most, "most");
  const int workers = check_threads(threads);
  const Cloud cloud = check_cloud(positions, normals, radii, thickness);
  Buffer<double> squares;
  {
    const Unlocked unlocked;
    squares = make_buffer<double>(wanted);
    const std::vector<Alike> sorted = sort_cloud(cloud, std::sqrt(most));
    run_ranges(wanted, workers, [&](int64_t start, int64_t stop) {
      std::vector<Around> around(sorted.begin(), sorted.end());
      Least lowest(number, enough, least, most);
      for (int64_t i = start; i < stop; ++i) {
        lowest.begin();
        for (Around& alike : around)
          if (!alike.visit(places + 3 * i, most, [&](const Point& point, const double* along, double square) {
                return lowest.lower(ways + 3 * number * i, along, square, point.thickness / point.radius);
              }))
            break;
        squares[i] = lowest.largest();
      }
    });
  }
  return give(std::move(squares), {static_cast<size_t>(wanted)});
}

}  // namespace

HPC_KERNELS {
  module.def("count_supporting", &count_supporting, "places"_a, "positions"_a, "normals"_a, "radii"_a, "thickness"_a,
             "threads"_a = 1);
  module.def("measure_aside", &measure_aside, "places"_a, "ways"_a, "positions"_a, "normals"_a, "radii"_a,
             "thickness"_a, "enough"_a, "least"_a, "most"_a, "threads"_a = 1);
}

}  // namespace hpc
