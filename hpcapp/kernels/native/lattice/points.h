// Points on a lattice: the cells that they lie in, and their order by these.
#pragma once

#include "arrays.h"
#include "keys.h"

namespace hpc {

// Points are taken in chunks of so many: their coordinates are one row of lanes, axes in turn.
constexpr int POINTS_AT_ONCE = 64;
constexpr int32_t OFF = INT32_MIN;  // a coordinate that is not finite or too far out

// Find the cell of each point of a chunk, axis by axis as the points have them.
void place_chunk(const double* points, int width, const double* origin, double size, int32_t* places);

// Call body(i, place) with the cell of each point.
template <class Body>
void visit_places(const double* points, int64_t count, const double* origin, double size, const Body& body) {
  int32_t places[3 * POINTS_AT_ONCE];
  for (int64_t start = 0; start < count; start += POINTS_AT_ONCE) {
    if (start % (64 * POINTS_AT_ONCE) == 0) poll();
    const int width = static_cast<int>(std::min<int64_t>(POINTS_AT_ONCE, count - start));
    place_chunk(points + 3 * start, width, origin, size, places);
    for (int i = 0; i < width; ++i) {
      const Place place{places[3 * i], places[3 * i + 1], places[3 * i + 2]};
      if (place[0] == OFF || place[1] == OFF || place[2] == OFF)
        refuse("positions: a point lies off the lattice (not finite, or too many cells away)");
      body(start + i, place);
    }
  }
}

// Return the points' rows in the order of their cells, stably, and the cells' squeezed keys.
Ranking rank_points(const double* points, int64_t count, const double* origin, double size, Span& span);

// Find the cell of each point.
void find_places(const double* points, int64_t count, const double* origin, double size, Place* places);

// Express points relative to the centres of their cells, in cells.
void centre_points(double* points, int64_t count, const double* origin, double size);

}  // namespace hpc
