// Which groups of points lie side by side (see around/links.py).
#include <mutex>

#include "arrays.h"
#include "constants.h"
#include "nearest.h"
#include "threads.h"

namespace hpc {
namespace {

using namespace constants::links;

constexpr int MOST = LINKED + 1;  // neighbours of a point, itself among them

struct Link {
  int64_t name, contacts, arms[3];
};

// Sort links, and make those of one name one.
void merge(std::vector<Link>& links) {
  std::sort(links.begin(), links.end(), [](const Link& a, const Link& b) { return a.name < b.name; });
  size_t kept = 0;
  for (const Link& link : links) {
    if (kept && links[kept - 1].name == link.name) {
      links[kept - 1].contacts += link.contacts;
      for (int axis = 0; axis < 3; ++axis) links[kept - 1].arms[axis] += link.arms[axis];
    } else {
      links[kept++] = link;
    }
  }
  links.resize(kept);
}

// Find the links of the points of some cells.
void link_cells(const UnitPoints& points, const uint8_t* own, const int64_t* group_of, int64_t count, int64_t start,
                int64_t stop, std::vector<Link>& links) {
  NearestSearch search(points, MOST, REACH);
  std::vector<int> wanted;
  std::vector<Link> found;
  for (int64_t cell = start; cell < stop; ++cell) {
    const uint32_t* rows = points.rows.get() + points.offsets[cell];
    wanted.clear();
    found.clear();
    for (int64_t i = 0; i < points.offsets[cell + 1] - points.offsets[cell]; ++i)
      if (own[rows[i]]) wanted.push_back(static_cast<int>(i));
    search.search(cell, wanted, [&](int i, const Neighbours& near) {
      const int64_t group = group_of[rows[i]];
      const int nearer = near.count(MOST);
      for (int k = 0; k < nearer; ++k) {
        const int64_t other = group_of[points.rows[near.at[k]]];
        if (other == group) continue;
        const int64_t sign = group < other ? 1 : -1, x = static_cast<int64_t>(near.x[k]);
        const int64_t y = static_cast<int64_t>(near.y[k]), z = static_cast<int64_t>(near.z[k]);
        found.push_back({std::min(group, other) * count + std::max(group, other), 1, {sign * x, sign * y, sign * z}});
      }
    });
    merge(found);
    links.insert(links.end(), found.begin(), found.end());
  }
}

nb::tuple link_groups(Doubles positions, Bytes own_of, Integers groups, Doubles low_of, double spacing,
                      int64_t threads) {
  const double* point = check<double>(positions, "positions", {ANY, 3});
  const int64_t count = rows_of(positions);
  const uint8_t* own = check<uint8_t>(own_of, "own", {count});
  const int64_t* group_of = check<int64_t>(groups, "group_of", {count});
  const double* low = check<double>(low_of, "low", {3});
  check_positive(spacing, "spacing");
  if (count >= INT32_MAX) refuse("positions: too many points");
  for (int64_t i = 0; i < count; ++i)
    if (group_of[i] < 0 || group_of[i] >= count) refuse("group_of: a row is out of range");
  const int workers = check_threads(threads);
  Large<int64_t> first, second, contacts;
  Buffer<int64_t> arms;
  {
    const Unlocked unlocked;
    const UnitPoints points = place_points(point, count, low, spacing);
    std::vector<Link> links;
    std::mutex lock;
    run_ranges(points.cells(), workers, [&](int64_t start, int64_t stop) {
      std::vector<Link> some;
      link_cells(points, own, group_of, count, start, stop, some);
      const std::lock_guard<std::mutex> locked(lock);
      links.insert(links.end(), some.begin(), some.end());
    });
    merge(links);
    arms = make_buffer<int64_t>(3 * links.size());
    for (const Link& link : links) {
      std::copy_n(link.arms, 3, arms.get() + 3 * first.size());
      first.push_back(link.name / count);
      second.push_back(link.name % count);
      contacts.push_back(link.contacts);
    }
  }
  const size_t n = first.size();
  return nb::make_tuple(give(std::move(first)), give(std::move(second)), give(std::move(contacts)),
                        give(std::move(arms), {n, 3}));
}

}  // namespace

HPC_KERNELS {
  module.def("link_groups", &link_groups, "positions"_a, "own"_a, "group_of"_a, "low"_a, "spacing"_a,
             "threads"_a = 1);
}

}  // namespace hpc
