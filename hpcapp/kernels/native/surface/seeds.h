// The bricks of a grid that hold a point.
#pragma once

#include <cstdint>

#include "arrays.h"
#include "lattice/keys.h"

namespace hpc {

class BrickSet {
 public:
  // Of a grid with so many bricks along each axis.
  explicit BrickSet(const int64_t* sides) : sides_{sides[0], sides[1], sides[2]} {}

  void add(const Place& place) {
    for (int axis = 0; axis < 3; ++axis)
      if (place[axis] < 0 || place[axis] >= sides_[axis]) refuse("positions: a point lies off the grid");
    const int64_t key = pack(place);
    if (key != last_) held_.add(key);  // points of one brick often follow each other
    last_ = key;
  }

  // Return the keys of those that were added, sorted.
  Large<int64_t> keys() const { return held_.keys(); }

 private:
  Place sides_;
  KeySet held_;
  int64_t last_ = -1;
};

}  // namespace hpc
