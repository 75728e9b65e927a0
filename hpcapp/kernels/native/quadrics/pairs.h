// Sums of moments over pairs of neighbouring cells: along z, then y, then x. What neighbouring
// corners have in common is summed once.
#pragma once

#include "arrays.h"
#include "lattice/keys.h"
#include "moments.h"

namespace hpc {

// Rows of moments by sorted keys, whole blocks of them.
class MomentRows {
 public:
  int64_t count() const { return static_cast<int64_t>(keys_.size()); }
  const int64_t* keys() const { return keys_.data(); }
  const double* moments() const { return moments_.data(); }

  // Take the sums of rows along an axis, 2 or 1: of the row before each key, a step away, and of its own.
  void sum(const int64_t* keys, int64_t count, const double* moments, int axis);

 private:
  std::vector<int64_t> keys_, low_, high_;
  std::vector<double> moments_;
};

// The sums over the eight cells around corners, which come in the order of their keys.
class CornerSums {
 public:
  CornerSums(const int64_t* cells, int64_t count, const double* moments)
      : cells_(cells), end_(cells + count), moments_(moments) {}

  // Prepare for corners with a biased x.
  void reach(int64_t x) {
    if (x == x_) return;
    if (x == x_ + 1) {
      std::swap(layers_[0], layers_[1]);
    } else {
      take(x - 1, layers_[0]);
    }
    take(x, layers_[1]);
    x_ = x;
    for (int side = 0; side < 2; ++side) fingers_[side] = Finger(layers_[side].keys(), layers_[side].count());
  }

  // Sum around eight corners of that x, the last one again where there are fewer.
  HPC_INLINE void load(const int64_t* corners, int width, Block& total) {
    Block low, high;
    int64_t rows[2][LANES];
    for (int lane = 0; lane < LANES; ++lane) {
      const int64_t key = corners[std::min(lane, width - 1)];
      rows[0][lane] = fingers_[0].find(key - STRIDES[0]);
      rows[1][lane] = fingers_[1].find(key);
    }
    load_rows(layers_[0].moments(), rows[0], low);
    load_rows(layers_[1].moments(), rows[1], high);
    sum_pair<0>(low, high, total);
  }

 private:
  // Sum the cells of a layer along z and y.
  void take(int64_t x, MomentRows& layer) {
    const int64_t* start = std::lower_bound(cells_, end_, x * STRIDES[0]);
    const int64_t* stop = std::lower_bound(start, end_, (x + 1) * STRIDES[0]);
    along_z_.sum(start, stop - start, moments_ + (start - cells_) * COLUMNS, 2);
    layer.sum(along_z_.keys(), along_z_.count(), along_z_.moments(), 1);
  }

  const int64_t *cells_, *end_;
  const double* moments_;
  int64_t x_ = -2;
  MomentRows along_z_, layers_[2];
  Finger fingers_[2] = {Finger(nullptr, 0), Finger(nullptr, 0)};
};

// Call body(start, stop) for the runs of corners in one layer each, whose sums are prepared.
template <class Body>
void visit_layers(CornerSums& sums, const int64_t* corners, int64_t start, int64_t stop, const Body& body) {
  while (start < stop) {
    const int64_t x = corners[start] / STRIDES[0];
    const int64_t next = std::lower_bound(corners + start, corners + stop, (x + 1) * STRIDES[0]) - corners;
    sums.reach(x);
    body(start, next);
    start = next;
  }
}

}  // namespace hpc
