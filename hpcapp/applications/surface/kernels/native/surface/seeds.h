// The bricks of a grid that hold a point.
#pragma once

#include <cstdint>
#include <vector>

#include "arrays.h"
#include "lattice/keys.h"

namespace hpc {

class BrickSet {
 public:
  // Of a grid with so many bricks along each axis.
  explicit BrickSet(const int64_t* sides)
      : sides_{sides[0], sides[1], sides[2]}, held_(static_cast<size_t>(sides[0] * sides[1] * sides[2])) {}

  void add(const Place& place) {
    for (int axis = 0; axis < 3; ++axis)
      if (place[axis] < 0 || place[axis] >= sides_[axis]) refuse("positions: a point lies off the grid");
    held_[static_cast<size_t>((place[0] * sides_[1] + place[1]) * sides_[2] + place[2])] = true;
  }

  // Return the keys of those that were added, sorted.
  Large<int64_t> keys() const {
    Large<int64_t> keys;
    size_t at = 0;
    for (int64_t x = 0; x < sides_[0]; ++x)
      for (int64_t y = 0; y < sides_[1]; ++y)
        for (int64_t z = 0; z < sides_[2]; ++z)
          if (held_[at++]) keys.push_back(pack({x, y, z}));
    return keys;
  }

 private:
  Place sides_;
  std::vector<bool> held_;
};

}  // namespace hpc
