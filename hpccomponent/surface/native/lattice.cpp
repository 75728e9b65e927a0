// Sets of places: all within a box around each, and all parents.
#include "families.h"
#include "keys.h"

namespace hpc {
namespace {

// Return the union of sorted keys shifted by each of several steps, by merging.
Large<int64_t> merge_shifted(const Large<int64_t>& keys, int64_t stride, int low, int high) {
  const size_t streams = static_cast<size_t>(high - low + 1);
  std::vector<size_t> at(streams, 0);
  Large<int64_t> merged;
  merged.reserve(keys.size() * 2);
  const int64_t end = INT64_MAX;
  std::vector<int64_t> head(streams);
  for (size_t s = 0; s < streams; ++s)
    head[s] = keys.empty() ? end : keys[0] + (low + static_cast<int>(s)) * stride;
  while (true) {
    int64_t least = end;
    for (int64_t key : head) least = std::min(least, key);
    if (least == end) return merged;
    merged.push_back(least);
    for (size_t s = 0; s < streams; ++s)
      if (head[s] == least)
        head[s] = ++at[s] < keys.size() ? keys[at[s]] + (low + static_cast<int>(s)) * stride : end;
  }
}

Output<int64_t> spread_keys(Input keys_of, int64_t low, int64_t high) {
  const int64_t* keys = check_keys(keys_of, "keys");
  if (low > high || low < -8 || high > 8) refuse("low, high: expected -8 <= low <= high <= 8");
  Large<int64_t> spread(keys, keys + rows_of(keys_of));
  {
    nb::gil_scoped_release unlocked;
    for (int axis = 2; axis >= 0; --axis)
      spread = merge_shifted(spread, STRIDES[axis], static_cast<int>(low), static_cast<int>(high));
  }
  return give(std::move(spread));
}

// Halve one coordinate of each place; one that is odd has two parents. Sorted, unique.
Large<int64_t> halve_axis(const Large<int64_t>& keys, int axis) {
  Place low{BIAS, BIAS, BIAS}, high{-BIAS, -BIAS, -BIAS};
  for (int64_t key : keys) {
    const Place place = unpack(key);
    for (int a = 0; a < 3; ++a) {
      low[a] = std::min(low[a], place[a]);
      high[a] = std::max(high[a], place[a]);
    }
  }
  low[axis] >>= 1;
  high[axis] = (high[axis] + 1) >> 1;
  const Span span(low, high);
  Large<uint64_t> halved;
  halved.reserve(keys.size() + keys.size() / 2);
  for (int64_t key : keys) {
    Place place = unpack(key);
    const int64_t coordinate = place[axis];
    for (int64_t odd = 0; odd <= (coordinate & 1); ++odd) {
      place[axis] = (coordinate + odd) >> 1;
      const uint64_t squeezed = span.squeeze(place);
      if (halved.empty() || halved.back() != squeezed) halved.push_back(squeezed);
    }
  }
  // Halving the fastest axis leaves the order as it is.
  if (axis < 2) radix_sort(halved, span.bits());
  halved.erase(std::unique(halved.begin(), halved.end()), halved.end());
  Large<int64_t> result(halved.size());
  for (size_t i = 0; i < halved.size(); ++i) result[i] = pack(span.restore(halved[i]));
  return result;
}

Output<int64_t> parent_keys(Input keys_of) {
  const int64_t* keys = check_keys(keys_of, "keys");
  Large<int64_t> parents(keys, keys + rows_of(keys_of));
  {
    nb::gil_scoped_release unlocked;
    for (int axis = 2; axis >= 0 && !parents.empty(); --axis) parents = halve_axis(parents, axis);
  }
  return give(std::move(parents));
}

Output<int64_t> find_keys(Input keys_of, Input wanted_of) {
  const int64_t* keys = check_keys(keys_of, "keys");
  const int64_t* wanted = check<int64_t>(wanted_of, "wanted", {ANY});
  const int64_t known = rows_of(keys_of), count = rows_of(wanted_of);
  auto rows = make_buffer<int64_t>(count);
  {
    nb::gil_scoped_release unlocked;
    Finger finger(keys, known);
    for (int64_t i = 0; i < count; ++i) {
      const int64_t row = finger.find(wanted[i]);
      rows[i] = row < 0 ? known : row;
    }
  }
  return give(std::move(rows), {static_cast<size_t>(count)});
}

Output<int64_t> unite_keys(Input first_of, Input second_of) {
  const int64_t* first = check_keys(first_of, "first");
  const int64_t* second = check_keys(second_of, "second");
  Large<int64_t> both;
  {
    nb::gil_scoped_release unlocked;
    std::set_union(first, first + rows_of(first_of), second, second + rows_of(second_of),
                   std::back_inserter(both));
  }
  return give(std::move(both));
}

}  // namespace

void bind_lattice(nb::module_& module) {
  module.def("spread_keys", &spread_keys);
  module.def("parent_keys", &parent_keys);
  module.def("find_keys", &find_keys);
  module.def("unite_keys", &unite_keys);
}

}  // namespace hpc
