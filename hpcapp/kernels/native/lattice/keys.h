// Places on a lattice as sorted 63-bit keys: packing, finding, sorting (see geometry/lattice.py).
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "constants.h"
#include "interruption.h"
#include "memory.h"

namespace hpc {

using constants::lattice::BITS, constants::lattice::STRIDES;
constexpr int64_t BIAS = constants::lattice::BIAS, MASK = constants::lattice::MASK;

using Place = std::array<int64_t, 3>;

inline bool in_range(int64_t coordinate) { return coordinate >= -BIAS && coordinate < BIAS; }

inline int64_t pack(const Place& place) {
  return (place[0] + BIAS) * STRIDES[0] + (place[1] + BIAS) * STRIDES[1] + place[2] + BIAS;
}

inline Place unpack(int64_t key) {
  return {(key >> 2 * BITS & MASK) - BIAS, (key >> BITS & MASK) - BIAS, (key & MASK) - BIAS};
}

// Finds keys that come in nearly rising order, starting from where the last one was.
class Finger {
 public:
  Finger(const int64_t* keys, int64_t count) : keys_(keys), count_(count) {}

  // Return the first row whose key is not below `key`.
  int64_t lower_bound(int64_t key) {
    int64_t low = at_, high = at_, step = 1;
    if (low < count_ && keys_[low] < key) {
      while (high < count_ && keys_[high] < key) low = high + 1, high += step, step *= 2;
      high = std::min(high, count_);
    } else {
      while (low > 0 && keys_[low - 1] >= key) high = low - 1, low = std::max<int64_t>(0, low - 1 - step), step *= 2;
    }
    at_ = std::lower_bound(keys_ + low, keys_ + high, key) - keys_;
    return at_;
  }

  // Return the row of `key`, -1 where it is missing.
  int64_t find(int64_t key) {
    const int64_t row = lower_bound(key);
    return row < count_ && keys_[row] == key ? row : -1;
  }

 private:
  const int64_t* keys_;
  int64_t count_;
  int64_t at_ = 0;
};

// The occupied cells around a cell, in the order of their keys: at most 27 rows.
class Neighbourhood {
 public:
  Neighbourhood(const int64_t* keys, int64_t count) : keys_(keys), count_(count) {
    fingers_.assign(9, Finger(keys, count));
  }

  // Return how many rows were found around `key`; they are in `rows`.
  int gather(int64_t key) {
    int found = 0;
    for (int column = 0; column < 9; ++column) {
      const int64_t middle = key + (column / 3 - 1) * STRIDES[0] + (column % 3 - 1) * STRIDES[1];
      int64_t row = fingers_[static_cast<size_t>(column)].lower_bound(middle - 1);
      for (; row < count_ && keys_[row] <= middle + 1; ++row) rows[found++] = row;
    }
    return found;
  }

  int64_t rows[27];

 private:
  const int64_t* keys_;
  int64_t count_;
  std::vector<Finger> fingers_;  // one for each column of cells: each walks on as the keys rise
};

// Finds the rows of sorted keys, in any order.
class KeyRows {
 public:
  KeyRows(const int64_t* keys, int64_t count) : keys_(keys), none_(static_cast<uint32_t>(count)) {
    size_t size = 64;
    while (size < 2 * static_cast<size_t>(count)) size *= 2;
    slots_.assign(size, none_);
    for (uint32_t row = 0; row < none_; ++row) {
      size_t at = slot(keys[row]);
      while (slots_[at] != none_) at = (at + 1) & (slots_.size() - 1);
      slots_[at] = row;
    }
  }

  uint32_t find(int64_t key) const {
    size_t at = slot(key);
    while (slots_[at] != none_ && keys_[slots_[at]] != key) at = (at + 1) & (slots_.size() - 1);
    return slots_[at];
  }

 private:
  size_t slot(int64_t key) const {
    return (static_cast<uint64_t>(key) * 0x9E3779B97F4A7C15u >> 20) & (slots_.size() - 1);
  }

  const int64_t* keys_;
  uint32_t none_;
  std::vector<uint32_t> slots_;
};

// A set of keys, not negative, that come in any order.
class KeySet {
 public:
  explicit KeySet(size_t expected = 0) {
    size_t size = 1024;
    while (size < 2 * expected) size *= 2;
    slots_.assign(size, -1);
  }

  void add(int64_t key) {
    if (2 * (count_ + 1) > slots_.size()) grow();
    insert(key);
  }

  int64_t count() const { return static_cast<int64_t>(count_); }

  // Return the keys, sorted.
  Large<int64_t> keys() const {
    Large<int64_t> keys;
    keys.reserve(count_);
    for (int64_t key : slots_)
      if (key != -1) keys.push_back(key);
    std::sort(keys.begin(), keys.end());
    return keys;
  }

 private:
  void insert(int64_t key) {
    size_t at = (static_cast<uint64_t>(key) * 0x9E3779B97F4A7C15u >> 20) & (slots_.size() - 1);
    while (slots_[at] != -1 && slots_[at] != key) at = (at + 1) & (slots_.size() - 1);
    count_ += slots_[at] == -1;
    slots_[at] = key;
  }

  void grow() {
    std::vector<int64_t> old(slots_.size() * 2, -1);
    old.swap(slots_);
    count_ = 0;
    for (int64_t key : old)
      if (key != -1) insert(key);
  }

  std::vector<int64_t> slots_;
  size_t count_ = 0;
};

// Packs places within a box into as few bits as they need, in the order of their keys.
class Span {
 public:
  Span(const Place& low, const Place& high) : low_(low) {
    for (int axis = 0; axis < 3; ++axis)
      while (bits_[axis] < 62 && (high[axis] - low[axis]) >> bits_[axis]) ++bits_[axis];
  }

  int bits() const { return bits_[0] + bits_[1] + bits_[2]; }

  uint64_t squeeze(const Place& place) const {
    uint64_t key = static_cast<uint64_t>(place[0] - low_[0]);
    key = key << bits_[1] | static_cast<uint64_t>(place[1] - low_[1]);
    return key << bits_[2] | static_cast<uint64_t>(place[2] - low_[2]);
  }

  Place restore(uint64_t key) const {
    const auto cut = [&key](int bits) {
      const int64_t part = static_cast<int64_t>(key & ((uint64_t{1} << bits) - 1));
      key >>= bits;
      return part;
    };
    Place place;
    for (int axis = 2; axis >= 0; --axis) place[axis] = low_[axis] + cut(bits_[axis]);
    return place;
  }

 private:
  Place low_;
  int bits_[3] = {0, 0, 0};
};

// Sort by the `bits` bits of rank(item), stably, in passes of at most 11 bits.
template <class Item, class Rank>
void radix_sort(Buffer<Item>& items, int64_t count, int bits, const Rank& rank) {
  const int passes = (bits + 10) / 11;
  if (!passes) return;
  const int digit = (bits + passes - 1) / passes;
  const uint64_t mask = (uint64_t{1} << digit) - 1;
  std::vector<int64_t> starts(static_cast<size_t>(passes) << digit, 0);
  for (int64_t i = 0; i < count; ++i) {
    const uint64_t key = rank(items[i]);
    for (int pass = 0; pass < passes; ++pass)
      ++starts[static_cast<size_t>(pass) << digit | (key >> pass * digit & mask)];
  }
  Buffer<Item> other = make_buffer<Item>(count);
  for (int pass = 0; pass < passes; ++pass) {
    poll();
    int64_t* next = starts.data() + (static_cast<size_t>(pass) << digit);
    for (int64_t value = 0, before = 0; value <= static_cast<int64_t>(mask); ++value) {
      const int64_t size = next[value];
      next[value] = before;
      before += size;
    }
    for (int64_t i = 0; i < count; ++i) other[next[rank(items[i]) >> pass * digit & mask]++] = items[i];
    items.swap(other);
  }
}

// Rows in the order of their keys; a row and its key are one number where they fit.
class Ranking {
 public:
  // For some of so many rows, and keys of so many bits.
  Ranking(int64_t rows, int bits) : bits_(bits) {
    while ((rows - 1) >> row_bits_ > 0) ++row_bits_;
    if (bits + row_bits_ <= 64) {
      packed_ = make_buffer<uint64_t>(rows);
    } else {
      apart_ = make_buffer<Apart>(rows);
    }
  }

  // Rows come in rising order.
  void add(int64_t row, uint64_t key) {
    if (packed_) {
      packed_[count_++] = key << row_bits_ | static_cast<uint64_t>(row);
    } else {
      apart_[count_++] = {key, static_cast<uint32_t>(row)};
    }
  }

  void sort() {
    int64_t risen = 1;
    while (risen < count_ && key(risen - 1) <= key(risen)) ++risen;
    if (risen >= count_) return;  // arranged points are ranked by their blocks again and again
    if (packed_) {
      radix_sort(packed_, count_, bits_, [shift = row_bits_](uint64_t item) { return item >> shift; });
    } else {
      radix_sort(apart_, count_, bits_, [](const Apart& item) { return item.key; });
    }
  }

  int64_t count() const { return count_; }
  uint64_t key(int64_t i) const { return packed_ ? packed_[i] >> row_bits_ : apart_[i].key; }
  uint32_t row(int64_t i) const {
    return packed_ ? static_cast<uint32_t>(packed_[i] & ((uint64_t{1} << row_bits_) - 1)) : apart_[i].row;
  }
  bool begins(int64_t i) const { return !i || key(i) != key(i - 1); }

  // How many different keys there are.
  int64_t runs() const {
    int64_t runs = 0;
    for (int64_t i = 0; i < count_; ++i) runs += begins(i);
    return runs;
  }

 private:
  struct Apart {
    uint64_t key;
    uint32_t row;
  };
  int64_t count_ = 0;
  int bits_, row_bits_ = 0;
  Buffer<uint64_t> packed_;
  Buffer<Apart> apart_;
};

}  // namespace hpc
