// Disjoint sets: the components of a graph whose edges come one by one.
#pragma once

#include <cstdint>
#include <numeric>
#include <vector>

namespace hpc {

// Joins numbers to sets; the lowest number of a set stands for it.
class Sets {
 public:
  explicit Sets(int64_t count) : parent_(static_cast<size_t>(count)) {
    std::iota(parent_.begin(), parent_.end(), 0);
  }

  int32_t find(int32_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }

  void join(int32_t a, int32_t b) {
    if (parent_[a] == parent_[b]) return;  // so it is nearly always
    a = find(a);
    b = find(b);
    if (a < b) parent_[b] = a;
    if (b < a) parent_[a] = b;
  }

  // Number the sets in the order of their lowest members; return how many there are.
  int32_t number(int32_t* label) {
    int32_t count = 0;
    for (size_t i = 0; i < parent_.size(); ++i) {
      const int32_t root = find(static_cast<int32_t>(i));
      label[i] = root == static_cast<int32_t>(i) ? count++ : label[root];
    }
    return count;
  }

 private:
  std::vector<int32_t> parent_;
};

}  // namespace hpc
