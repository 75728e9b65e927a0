// Sums of moments over pairs of neighbouring cells (see pairs.h).
#include "pairs.h"

namespace hpc {
namespace {

template <int AXIS>
HPC_INLINE void sum_blocks(const double* moments, const int64_t* low, const int64_t* high, int64_t count, double* sums) {
  Block below, above, sum;
  for (int64_t start = 0; start < count; start += LANES) {
    load_rows(moments, low + start, below);
    load_rows(moments, high + start, above);
    sum_pair<AXIS>(below, above, sum);
    store_rows(sum, sums + start * COLUMNS);
  }
}

HPC_CLONES void sum_along_z(const double* moments, const int64_t* low, const int64_t* high, int64_t count, double* sums) {
  sum_blocks<2>(moments, low, high, count, sums);
}

HPC_CLONES void sum_along_y(const double* moments, const int64_t* low, const int64_t* high, int64_t count, double* sums) {
  sum_blocks<1>(moments, low, high, count, sums);
}

}  // namespace

void MomentRows::sum(const int64_t* keys, int64_t count, const double* moments, int axis) {
  keys_.clear();
  low_.clear();
  high_.clear();
  for (int64_t own = 0, before = 0; before < count;) {
    const int64_t key = own < count ? std::min(keys[own], keys[before] + STRIDES[axis]) : keys[before] + STRIDES[axis];
    const bool is_own = own < count && keys[own] == key, is_before = keys[before] + STRIDES[axis] == key;
    keys_.push_back(key);
    high_.push_back(is_own ? own++ : -1);
    low_.push_back(is_before ? before++ : -1);
  }
  const size_t rounded = (keys_.size() + LANES - 1) / LANES * LANES;
  high_.resize(rounded, -1);
  low_.resize(rounded, -1);
  if (moments_.size() < rounded * COLUMNS) moments_.resize(rounded * COLUMNS);
  const auto sum = axis == 2 ? sum_along_z : sum_along_y;
  sum(moments, low_.data(), high_.data(), static_cast<int64_t>(rounded), moments_.data());
}

}  // namespace hpc
