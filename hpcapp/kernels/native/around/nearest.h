// The nearest neighbours of points, in whole numbers (see around/nearest.py).
#pragma once

#include <cmath>
#include <deque>
#include <functional>
#include <vector>

#include "arrays.h"
#include "constants.h"
#include "lattice/keys.h"

namespace hpc {

constexpr double UNITS = constants::nearest::UNITS;  // in a spacing
constexpr int64_t CELL_UNITS = int64_t{constants::nearest::CELL} * constants::nearest::UNITS;

// Points by the cells of 5 spacings that they lie in.
struct UnitPoints {
  Large<int64_t> keys, offsets;  // cell i holds the points offsets[i] to offsets[i + 1]
  Buffer<uint32_t> rows;         // of the points in the cloud, rising within a cell
  Buffer<int32_t> places;        // (n, 3): in units from the corner of the cell

  int64_t cells() const { return static_cast<int64_t>(keys.size()); }
};

UnitPoints place_points(const double* points, int64_t count, const double* low, double spacing);

// The neighbours of a point, nearest first, itself among them.
struct Neighbours {
  const double *x, *y, *z, *squares;  // seen from the point, in units; and of their distances
  const uint32_t* at;                 // which they are, in the order of `UnitPoints`
  int listed;

  // Return how many are nearer than the first beyond the `most` nearest.
  int count(int most) const {
    if (listed <= most) return listed;
    const double bound = std::sqrt(squares[most]) - constants::nearest::ROUNDED;
    int nearer = most;
    while (nearer && !(std::sqrt(squares[nearer - 1]) < bound)) --nearer;
    return nearer;
  }
};

// Finds the neighbours of the points of one cell after the other; each thread has its own.
//
// What lies around a cell is looked through for each of its points. Where that is much, the cell is
// cut into eight, and what lies around an eighth is looked through. Where it is too little to tell,
// because others beyond may be nearer, it is as much more as is needed: the result is exact.
class NearestSearch {
 public:
  using Take = std::function<void(int, const Neighbours&)>;

  // For the `most` nearest within so many spacings.
  NearestSearch(const UnitPoints& points, int most, int reach);

  // Call take(i, neighbours) for the wanted points of a cell, numbered from its first, in any order.
  void search(int64_t cell, const std::vector<int>& wanted, const Take& take);

 private:
  // A cube, and the margin around it in which all points are known; in units from the cell's corner.
  struct Box {
    double low[3], edge, margin;
  };

  // What is known around a box.
  struct Around {
    Box box;
    std::vector<double> x, y, z;
    std::vector<uint32_t> at;
    size_t count = 0;
    std::vector<int> wanted, octants, some, unsolved;

    void make_room(size_t most);
  };

  void gather(int64_t cell, double margin);
  void filter(const Around& all, Around& part) const;
  void solve(size_t depth, const std::vector<int>& wanted, std::vector<int>& unsolved, const Take& take);
  bool cut(const Box& box, Box& part) const;
  Around& around(size_t depth);
  bool find(const Around& all, int one, const Take& take);
  int take_below(size_t count, double bound);
  void take_nearest(size_t count, int found);
  int put_in_order(const Around& all, const double (&point)[3], int found);

  const UnitPoints& points_;
  const int most_;
  const double reach_;
  int64_t first_ = 0;  // point of the cell
  double guess_;       // of the squared distance that a point's neighbours lie within
  std::vector<std::vector<Finger>> fingers_;
  std::deque<Around> stack_;
  std::vector<double> squares_, near_squares_, x_, y_, z_, ordered_;
  std::vector<float> rounded_;
  std::vector<uint32_t> near_, order_, at_;
  std::vector<int32_t> ranks_, ties_;
};

}  // namespace hpc
