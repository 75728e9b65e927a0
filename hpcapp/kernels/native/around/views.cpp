// Which patches are seen from a viewpoint (see around/views.py).
#include <algorithm>
#include <cmath>

#include "arrays.h"
#include "clones.h"
#include "constants.h"
#include "threads.h"

namespace hpc {
namespace {

using namespace constants::views;
using constants::WHOLE;

constexpr uint32_t NONE = UINT32_MAX;
constexpr int64_t AT_ONCE = 4;  // viewpoints, between which a job may end: each goes through all patches

// Patches, one by one, and axis by axis.
struct Patches {
  int64_t count;
  const double *centres, *normals, *thickness, *least;
  Large<double> centre[3], normal[3];
};

// What is found of the patches from one viewpoint; each thread has its own.
struct View {
  Large<double> far, cosine, sorted, across[2];
  Large<uint8_t> side, level, is_clear;
  Large<int64_t> name;    // of the pixel of each patch
  Large<uint32_t> shown;  // of pixels the nearest patch, at a place that follows from their names

  explicit View(int64_t count) {
    const size_t patches = static_cast<size_t>(count);
    for (auto* column : {&far, &cosine, &sorted, &across[0], &across[1]}) column->resize(patches);
    for (auto* column : {&side, &level, &is_clear}) column->resize(patches);
    name.resize(patches);
    size_t places = 64;
    while (places < 2 * patches) places *= 2;
    shown.assign(places, NONE);
  }
};

// Name the pixels in which patches lie: so many along an edge of a face.
HPC_CLONES void name_pixels(const double* first, const double* second, const uint8_t* side, int64_t count,
                            double pixel, double shift, int64_t edge, int64_t* name) {
  HPC_LANES
  for (int64_t i = 0; i < count; ++i) {
    const int32_t row = static_cast<int32_t>(std::floor((first[i] + 1.0) / pixel + shift));
    const int32_t column = static_cast<int32_t>(std::floor((second[i] + 1.0) / pixel + shift));
    name[i] = (side[i] * edge + row) * edge + column;
  }
}

// Find how far patches are, and where the lines of sight meet the cube around the viewpoint.
HPC_CLONES void project(const double* const (&centre)[3], const double* const (&normal)[3], int64_t count,
                        const double* viewpoint, double nearest, double* far, double* cosine, double* first,
                        double* second, uint8_t* side) {
  const double vx = viewpoint[0], vy = viewpoint[1], vz = viewpoint[2];
  const double *cx = centre[0], *cy = centre[1], *cz = centre[2];
  const double *nx = normal[0], *ny = normal[1], *nz = normal[2];
  HPC_LANES
  for (int64_t i = 0; i < count; ++i) {
    const double x = vx - cx[i], y = vy - cy[i], z = vz - cz[i];
    const double length = std::sqrt(x * x + y * y + z * z), away = length > nearest ? length : nearest;
    far[i] = away;
    cosine[i] = (x * nx[i] + y * ny[i] + z * nz[i]) / away;
    const double wide = std::abs(x), deep = std::abs(y), high = std::abs(z);
    const bool is_x = (wide >= deep) & (wide >= high), is_y = !is_x & (deep >= high);
    const double depth = is_x ? x : is_y ? y : z, size = std::abs(depth), scale = size > 0.0 ? size : 1.0;
    first[i] = (is_x ? y : is_y ? z : x) / scale;
    second[i] = (is_x ? z : is_y ? x : y) / scale;
    side[i] = static_cast<uint8_t>((is_x ? 0 : is_y ? 2 : 4) + (depth > 0.0));
  }
}

double find_median(const Large<double>& values, Large<double>& sorted) {
  std::copy(values.begin(), values.end(), sorted.begin());
  const auto middle = sorted.begin() + static_cast<int64_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  return sorted.size() % 2 ? *middle : (*std::max_element(sorted.begin(), middle) + *middle) / 2.0;
}

// Return where the patch that is shown in a pixel stands, or will.
inline uint32_t& show(View& view, int64_t name) {
  const size_t mask = view.shown.size() - 1;
  size_t at = static_cast<size_t>((static_cast<uint64_t>(name) * 0x9E3779B97F4A7C15u) >> 32) & mask;
  while (view.shown[at] != NONE && view.name[view.shown[at]] != name) at = (at + 1) & mask;
  return view.shown[at];
}

// Take back that patches are seen which lie behind the nearest of a level, in its pixels.
void hide(const Patches& patches, View& view, double pixel, double shift, uint8_t level, uint8_t* seen) {
  // One more for the shift, and one for rounding.
  const int64_t edge = static_cast<int64_t>(std::ceil(2.0 / pixel)) + 2;
  name_pixels(view.across[0].data(), view.across[1].data(), view.side.data(), patches.count, pixel, shift, edge,
              view.name.data());
  std::fill(view.shown.begin(), view.shown.end(), NONE);
  for (int64_t i = 0; i < patches.count; ++i) {
    if (view.level[i] != level) continue;
    uint32_t& front = show(view, view.name[i]);
    if (front == NONE || view.far[i] < view.far[front]) front = static_cast<uint32_t>(i);
  }
  for (int64_t i = 0; i < patches.count; ++i) {
    if (!seen[i]) continue;
    const uint32_t front = show(view, view.name[i]);
    if (front == NONE || !(view.far[i] > view.far[front])) continue;
    const int64_t at = front;
    double above[3];
    for (int axis = 0; axis < 3; ++axis)
      above[axis] = (patches.centres[3 * i + axis] - patches.centres[3 * at + axis]) * patches.normals[3 * at + axis];
    const double cosine = view.cosine[front], sign = cosine > 0.0 ? 1.0 : cosine < 0.0 ? -1.0 : 0.0;
    if ((above[0] + above[1] + above[2]) * sign < -patches.thickness[i]) seen[i] = false;
  }
}

// Look at all patches from one viewpoint.
void look(const Patches& patches, const double* viewpoint, double spacing, View& view, int8_t* cosines, bool* is_seen) {
  const double* const centre[3] = {patches.centre[0].data(), patches.centre[1].data(), patches.centre[2].data()};
  const double* const normal[3] = {patches.normal[0].data(), patches.normal[1].data(), patches.normal[2].data()};
  project(centre, normal, patches.count, viewpoint, std::max(NEAREST * spacing, 1e-300), view.far.data(),
          view.cosine.data(), view.across[0].data(), view.across[1].data(), view.side.data());
  const double pixel = std::max(PIXEL * spacing / find_median(view.far, view.sorted), FINEST);
  uint8_t* seen = reinterpret_cast<uint8_t*>(is_seen);
  int64_t drawn[LEVELS] = {};
  for (int64_t i = 0; i < patches.count; ++i) {
    const double width = PIXEL * spacing / view.far[i] / pixel, cosine = std::abs(view.cosine[i]);
    int level = 0;
    while (level < LEVELS - 1 && width > static_cast<double>(1 << level)) ++level;
    view.level[i] = static_cast<uint8_t>(level);
    ++drawn[level];
    seen[i] = cosine > LEAST_COSINE;
    view.is_clear[i] = cosine > std::max(patches.least[i], LEAST_COSINE);
  }
  for (int level = 0; level < LEVELS; ++level) {
    if (!drawn[level]) continue;
    const double wide = pixel * static_cast<double>(1 << level);
    hide(patches, view, wide, 0.0, static_cast<uint8_t>(level), seen);
    // What is not seen is not clearly seen.
    for (int64_t i = 0; i < patches.count; ++i) view.is_clear[i] &= seen[i];
    hide(patches, view, wide, 0.5, static_cast<uint8_t>(level), view.is_clear.data());
  }
  for (int64_t i = 0; i < patches.count; ++i)
    cosines[i] = seen[i] && view.is_clear[i] ? static_cast<int8_t>(std::rint(WHOLE * view.cosine[i])) : int8_t{0};
}

// Lengths whose squares are finite.
void check_lengths(const double* values, int64_t count, const char* name) {
  for (int64_t i = 0; i < count; ++i)
    if (!(std::abs(values[i]) < 1e150)) refuse(std::string(name) + ": expected finite numbers below 1e150");
}

nb::tuple view_patches(Doubles centres, Doubles normals, Doubles thickness, Doubles least, Doubles viewpoints_of,
                       double spacing, int64_t threads) {
  const double* centre = check<double>(centres, "centres", {ANY, 3});
  const int64_t count = rows_of(centres);
  const double* normal = check<double>(normals, "normals", {count, 3});
  const double* viewpoints = check<double>(viewpoints_of, "viewpoints", {ANY, 3});
  const int64_t views = rows_of(viewpoints_of);
  Patches patches{count, centre, normal, check<double>(thickness, "thickness", {count}),
                  check<double>(least, "least", {count}), {}, {}};
  check_lengths(centre, 3 * count, "centres");
  check_lengths(normal, 3 * count, "normals");
  check_lengths(viewpoints, 3 * views, "viewpoints");
  check_positive(spacing, "spacing");
  if (count >= NONE) refuse("centres: too many patches");
  const int workers = check_threads(threads);
  Buffer<int8_t> cosines;
  Buffer<bool> is_seen;
  {
    const Unlocked unlocked;
    cosines = make_buffer<int8_t>(views * count);
    is_seen = make_buffer<bool>(views * count);
    for (int axis = 0; axis < 3; ++axis)
      for (int64_t i = 0; i < count; ++i) {
        patches.centre[axis].push_back(centre[3 * i + axis]);
        patches.normal[axis].push_back(normal[3 * i + axis]);
      }
    run_ranges(count ? views : 0, workers, [&](int64_t start, int64_t stop) {
      if (start == stop) return;
      View view(count);
      for (int64_t row = start; row < stop; ++row)
        look(patches, viewpoints + 3 * row, spacing, view, &cosines[row * count], &is_seen[row * count]);
    }, AT_ONCE);
  }
  const std::initializer_list<size_t> shape = {static_cast<size_t>(views), static_cast<size_t>(count)};
  return nb::make_tuple(give(std::move(cosines), shape), give(std::move(is_seen), shape));
}

HPC_CLONES void add_view(const int8_t* cosines, const uint8_t* seen, int64_t count, int32_t* front, int32_t* back,
                         uint8_t* any) {
  HPC_LANES
  for (int64_t i = 0; i < count; ++i) {
    const int32_t cosine = cosines[i];
    front[i] += cosine > 0 ? cosine : 0;
    back[i] -= cosine < 0 ? cosine : 0;
    any[i] |= seen[i];
  }
}

nb::tuple add_views(Input cosines_of, Input is_seen_of) {
  const int8_t* cosines = check<int8_t>(cosines_of, "cosines", {ANY, ANY});
  const int64_t views = rows_of(cosines_of), count = static_cast<int64_t>(cosines_of.shape(1));
  const bool* is_seen = check<bool>(is_seen_of, "is_seen", {views, count});
  Buffer<int32_t> front, back;
  Buffer<bool> any;
  {
    const Unlocked unlocked;
    front = make_buffer<int32_t>(count);
    back = make_buffer<int32_t>(count);
    any = make_buffer<bool>(count);
    std::fill_n(front.get(), count, 0);
    std::fill_n(back.get(), count, 0);
    std::fill_n(any.get(), count, false);
    for (int64_t row = 0; row < views; ++row)
      add_view(cosines + row * count, reinterpret_cast<const uint8_t*>(is_seen) + row * count, count, front.get(),
               back.get(), reinterpret_cast<uint8_t*>(any.get()));
  }
  const size_t n = static_cast<size_t>(count);
  return nb::make_tuple(give(std::move(front), {n}), give(std::move(back), {n}), give(std::move(any), {n}));
}

}  // namespace

HPC_KERNELS {
  module.def("view_patches", &view_patches, "centres"_a, "normals"_a, "thickness"_a, "least"_a, "viewpoints"_a,
             "spacing"_a, "threads"_a = 1);
  module.def("add_views", &add_views, "cosines"_a, "is_seen"_a);
}

}  // namespace hpc
