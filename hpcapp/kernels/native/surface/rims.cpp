// How far around some bricks the surface must be known (see rims.py).
#include <nanobind/stl/optional.h>

#include <algorithm>
#include <cstring>
#include <optional>

#include "arrays.h"
#include "constants.h"

namespace hpc {
namespace {

using constants::grid::BRICK;

// How many cells lie between each brick of a box and the given ones; eight are too many.
class Depths {
 public:
  Depths(const bool* bricks, const int64_t* sides)
      : bricks_(bricks), sides_{sides[0], sides[1], sides[2]}, count_(sides[0] * sides[1] * sides[2]),
        depth_(make_buffer<uint8_t>(count_)), beyond_(static_cast<size_t>(sides[2]) + 2, uint8_t{BRICK}),
        least_(static_cast<size_t>(sides[2])) {
    std::fill_n(depth_.get(), count_, uint8_t{BRICK});
  }

  // Between the given bricks and their neighbours lies nothing.
  void begin() {
    visit_rows([&](int64_t x, int64_t y, int64_t start) {
      if (!std::memchr(bricks_ + start, true, static_cast<size_t>(sides_[2]))) return;
      for (int64_t z = 0; z < sides_[2]; ++z) beyond(z) = bricks_[start + z] ? 0 : BRICK;
      lower_around(x, y);
    });
  }

  // From the nearest bricks on, what lies beyond each is as many cells farther away as it has.
  void spread(const uint8_t* cells) {
    for (int from = 0; from + 1 < BRICK; ++from)
      visit_rows([&](int64_t x, int64_t y, int64_t start) {
        const uint8_t* depths = depth_.get() + start;
        if (!std::memchr(depths, from, static_cast<size_t>(sides_[2]))) return;
        for (int64_t z = 0; z < sides_[2]; ++z) {
          const bool is_way = depths[z] == from && !bricks_[start + z];
          const int most = std::min<int>(from + cells[start + z], BRICK);
          beyond(z) = static_cast<uint8_t>(is_way ? most : BRICK);
        }
        lower_around(x, y);
      });
  }

  Buffer<bool> marked() const {
    auto marked = make_buffer<bool>(count_);
    for (int64_t i = 0; i < count_; ++i) marked[i] = depth_[i] < BRICK;
    return marked;
  }

 private:
  // Call visit(x, y, start) for each row of bricks along z.
  template <class Visit>
  void visit_rows(const Visit& visit) const {
    for (int64_t x = 0; x < sides_[0]; ++x)
      for (int64_t y = 0; y < sides_[1]; ++y) visit(x, y, (x * sides_[1] + y) * sides_[2]);
  }

  // What lies around a brick of the row at hand is no farther away than this.
  uint8_t& beyond(int64_t z) { return beyond_[static_cast<size_t>(z) + 1]; }

  // Lower the depths around the row at hand.
  void lower_around(int64_t x, int64_t y) {
    const uint8_t* behind = beyond_.data();
    uint8_t* least = least_.data();
    for (int64_t z = 0; z < sides_[2]; ++z) least[z] = std::min({behind[z], behind[z + 1], behind[z + 2]});
    for (int64_t i = std::max<int64_t>(x - 1, 0); i < std::min(x + 2, sides_[0]); ++i)
      for (int64_t j = std::max<int64_t>(y - 1, 0); j < std::min(y + 2, sides_[1]); ++j) {
        uint8_t* depths = depth_.get() + (i * sides_[1] + j) * sides_[2];
        for (int64_t z = 0; z < sides_[2]; ++z) depths[z] = std::min(depths[z], least[z]);
      }
  }

  const bool* bricks_;
  int64_t sides_[3], count_;
  Buffer<uint8_t> depth_;
  std::vector<uint8_t> beyond_, least_;  // of a row along z; the first with one more at both ends
};

Output<bool> mark_rim(Input bricks_of, std::optional<Bytes> cells_of) {
  const bool* bricks = check<bool>(bricks_of, "bricks", {ANY, ANY, ANY});
  int64_t sides[3];
  for (size_t axis = 0; axis < 3; ++axis) sides[axis] = static_cast<int64_t>(bricks_of.shape(axis));
  const uint8_t* cells = nullptr;
  if (cells_of) {
    cells = check<uint8_t>(*cells_of, "cells", {sides[0], sides[1], sides[2]});
    if (std::find(cells, cells + cells_of->size(), 0) != cells + cells_of->size())
      refuse("cells: expected 1 or more");
  }
  Buffer<bool> marked;
  {
    const Unlocked unlocked;
    Depths depths(bricks, sides);
    depths.begin();
    if (cells) depths.spread(cells);
    marked = depths.marked();
  }
  const auto side = [&](size_t axis) { return static_cast<size_t>(sides[axis]); };
  return give(std::move(marked), {side(0), side(1), side(2)});
}

}  // namespace

HPC_KERNELS { module.def("mark_rim", &mark_rim, "bricks"_a, "cells"_a.none()); }

}  // namespace hpc
