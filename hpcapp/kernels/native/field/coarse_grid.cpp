// The coarse grid of the far field: the Poisson equation, solved by Fourier transforms, and sampling.
//
// Of the transforms, rows along z are transformed first, two real ones in each complex lane; then the frequencies
// along z are independent of one another, and a few of them at a time fit into the cache.
#include <algorithm>
#include <cmath>

#include "arrays.h"
#include "clones.h"
#include "fourier.h"
#include "lattice/keys.h"
#include "threads.h"

namespace hpc {
namespace {

// The lower node of a place, and how far beyond it the place lies; as trilinear weights need it.
struct Spot {
  int64_t node;
  double local[3];
};

inline Spot spot_of(const double* place, int64_t side) {
  Spot spot{0, {0, 0, 0}};
  for (int axis = 0; axis < 3; ++axis) {
    const double lower = std::min(std::max(std::floor(place[axis]), 0.0), static_cast<double>(side - 2));
    spot.node = spot.node * side + static_cast<int64_t>(lower);
    spot.local[axis] = place[axis] - lower;
  }
  return spot;
}

// Call body(node, weight) for the eight nodes around a place.
template <class Body>
inline void visit_corners(const Spot& spot, int64_t side, const Body& body) {
  for (int octant = 0; octant < 8; ++octant) {
    double factor[3];
    for (int axis = 0; axis < 3; ++axis)
      factor[axis] = (octant >> axis & 1) ? spot.local[axis] : 1.0 - spot.local[axis];
    const int64_t step = ((octant & 1) * side + (octant >> 1 & 1)) * side + (octant >> 2);
    body(spot.node + step, factor[0] * factor[1] * factor[2]);
  }
}

// The planes and the rows of the grid that are kept: all samples lie between them.
struct Held {
  int64_t first[2], size[2];
  int64_t rows() const { return size[0] * size[1]; }
};

Held take_held(const Input& held_of, int64_t nodes) {
  const int64_t* held = check<int64_t>(held_of, "held", {2, 2});
  for (int axis = 0; axis < 2; ++axis)
    if (held[2 * axis] < 0 || held[2 * axis] >= held[2 * axis + 1] || held[2 * axis + 1] > nodes)
      refuse("held: expected planes and rows of the grid");
  return {{held[0], held[2]}, {held[1] - held[0], held[3] - held[2]}};
}

void check_held(const double* places, int64_t count, int64_t nodes, const Held& held) {
  for (int64_t i = 0; i < count; ++i) {
    const int64_t row = spot_of(places + 3 * i, nodes).node / nodes;
    const int64_t at[2] = {row / nodes - held.first[0], row % nodes - held.first[1]};
    for (int axis = 0; axis < 2; ++axis)
      if (at[axis] < 0 || at[axis] + 1 >= held.size[axis]) refuse("places: a sample lies beyond what is held");
  }
}

// The positive frequencies along z of every held row, ROWS of them side by side. Half a turn a
// node, the highest, has no slope and is left out.
struct Spectrum {
  int64_t blocks;
  Large<Element> elements;

  Spectrum(int64_t rows, int64_t nodes) : blocks((nodes / 2 + ROWS - 1) / ROWS), elements(rows * blocks, Element{}) {}
  Element& at(int64_t row, int64_t block) { return elements[row * blocks + block]; }
};

// Spread one component of the normals on the held rows.
void spread_component(const double* places, const double* component, int64_t count, int64_t nodes, const Held& held,
                      float* grid) {
  std::fill(grid, grid + held.rows() * nodes, 0.0f);
  const int64_t before = held.first[0] * nodes + held.first[1];
  for (int64_t i = 0; i < count; ++i)
    visit_corners(spot_of(places + 3 * i, nodes), nodes, [&](int64_t node, double weight) {
      const int64_t row = node / nodes - before;
      grid[(row / nodes * held.size[1] + row % nodes) * nodes + node % nodes] +=
          static_cast<float>(weight * component[3 * i]);
    });
}

// Rows come in pairs of groups, from `begin` to `end`: what shares a lane does not hang on who transforms it.
HPC_CLONES void transform_rows(const Fourier& fourier, const float* grid, int64_t rows, int64_t begin, int64_t end,
                               Spectrum& spectrum) {
  const int64_t nodes = fourier.nodes;
  std::vector<Element> values(nodes);
  for (int64_t start = 2 * ROWS * begin; start < std::min(rows, 2 * ROWS * end); start += 2 * ROWS) {
    const int first = static_cast<int>(std::min<int64_t>(rows - start, ROWS));
    const int second = static_cast<int>(std::min<int64_t>(rows - start - first, ROWS));
    std::fill(values.begin(), values.end(), Element{});
    for (int lane = 0; lane < first; ++lane)
      for (int64_t z = 0; z < nodes; ++z) values[z].re[lane] = grid[(start + lane) * nodes + z];
    for (int lane = 0; lane < second; ++lane)
      for (int64_t z = 0; z < nodes; ++z) values[z].im[lane] = grid[(start + ROWS + lane) * nodes + z];
    transform(fourier, values.data());
    for (int64_t k = 0; k < nodes / 2; ++k) {
      const Element& f = values[fourier.place[k]];
      const Element& g = values[fourier.place[(nodes - k) % nodes]];
      const int64_t block = k / ROWS, at = k % ROWS;
      for (int lane = 0; lane < first; ++lane) {
        Element& to = spectrum.at(start + lane, block);
        to.re[at] = 0.5f * (f.re[lane] + g.re[lane]);
        to.im[at] = 0.5f * (f.im[lane] - g.im[lane]);
      }
      for (int lane = 0; lane < second; ++lane) {
        Element& to = spectrum.at(start + ROWS + lane, block);
        to.re[at] = 0.5f * (f.im[lane] + g.im[lane]);
        to.im[at] = 0.5f * (g.re[lane] - f.re[lane]);
      }
    }
  }
}

HPC_CLONES void transform_rows_back(const Fourier& fourier, Spectrum& spectrum, int64_t rows, int64_t begin,
                                    int64_t end, float* grid) {
  const int64_t nodes = fourier.nodes;
  const float scale = 1.0f / static_cast<float>(nodes * nodes * nodes);
  std::vector<Element> values(nodes);
  for (int64_t start = 2 * ROWS * begin; start < std::min(rows, 2 * ROWS * end); start += 2 * ROWS) {
    const int first = static_cast<int>(std::min<int64_t>(rows - start, ROWS));
    const int second = static_cast<int>(std::min<int64_t>(rows - start - first, ROWS));
    std::fill(values.begin(), values.end(), Element{});
    for (int64_t k = 0; k < nodes / 2; ++k) {
      Element& f = values[fourier.place[k]];
      Element& g = values[fourier.place[(nodes - k) % nodes]];
      const int64_t block = k / ROWS, at = k % ROWS;
      for (int lane = 0; lane < first; ++lane) {
        const Element& from = spectrum.at(start + lane, block);
        const float re = from.re[at], im = k ? from.im[at] : 0.0f;
        const Element* pair = lane < second ? &spectrum.at(start + ROWS + lane, block) : nullptr;
        const float other_re = pair ? pair->re[at] : 0.0f, other_im = pair && k ? pair->im[at] : 0.0f;
        g.re[lane] = re + other_im;
        g.im[lane] = other_re - im;
        f.re[lane] = re - other_im;
        f.im[lane] = other_re + im;
      }
    }
    transform_back(fourier, values.data());
    for (int lane = 0; lane < first; ++lane)
      for (int64_t z = 0; z < nodes; ++z) grid[(start + lane) * nodes + z] = scale * values[z].re[lane];
    for (int lane = 0; lane < second; ++lane)
      for (int64_t z = 0; z < nodes; ++z) grid[(start + ROWS + lane) * nodes + z] = scale * values[z].im[lane];
  }
}

// ROWS frequencies along z: their planes, and what one row or column of these needs.
struct Slab {
  const Fourier& fourier;
  const Held& held;
  std::vector<float> damping;     // at each place of the spectrum
  float kz[ROWS], damping_z[ROWS];
  Large<Element> sum, across;     // [held plane][place]: of the y and z components, and of x
  std::vector<Element> line, other;

  Slab(const Fourier& shared, const Held& kept, double smoothing)
      : fourier(shared), held(kept), damping(shared.nodes), sum(kept.size[0] * shared.nodes),
        across(kept.size[0] * shared.nodes), line(shared.nodes), other(shared.nodes) {
    for (int64_t i = 0; i < shared.nodes; ++i) damping[i] = damp(shared.frequency[i], smoothing);
  }

  static float damp(double frequency, double smoothing) {
    return static_cast<float>(std::exp(-0.5 * smoothing * smoothing * frequency * frequency));
  }

  void begin(int64_t block) {
    for (int lane = 0; lane < ROWS; ++lane) {
      const int64_t k = std::min<int64_t>(block * ROWS + lane, fourier.nodes / 2 - 1);
      kz[lane] = fourier.frequency[fourier.place[k]];
      damping_z[lane] = damping[fourier.place[k]];
    }
  }
};

// Transform the held rows of a plane along y, one component after the other.
HPC_INLINE void transform_plane(Slab& slab, Spectrum* components, int64_t block, int64_t x) {
  const int64_t nodes = slab.fourier.nodes, size = slab.held.size[1];
  Element* sum = &slab.sum[x * nodes];
  for (int axis = 0; axis < 3; ++axis) {
    Element* line = axis == 0 ? &slab.across[x * nodes] : axis == 1 ? sum : slab.line.data();
    std::fill(line, line + nodes, Element{});
    for (int64_t y = 0; y < size; ++y) line[slab.held.first[1] + y] = components[axis].at(x * size + y, block);
    transform(slab.fourier, line);
  }
  for (int64_t i = 0; i < nodes; ++i) {
    const float ky = slab.fourier.frequency[i];
    EACH_ROW {
      sum[i].re[lane] = ky * sum[i].re[lane] + slab.kz[lane] * slab.line[i].re[lane];
      sum[i].im[lane] = ky * sum[i].im[lane] + slab.kz[lane] * slab.line[i].im[lane];
    }
  }
}

// Transform one column along x, divide by -k^2, and go back.
HPC_INLINE void integrate_column(Slab& slab, int64_t y) {
  const int64_t nodes = slab.fourier.nodes, first = slab.held.first[0], size = slab.held.size[0];
  Element *sum = slab.line.data(), *across = slab.other.data();
  std::fill(sum, sum + nodes, Element{});
  std::fill(across, across + nodes, Element{});
  for (int64_t x = 0; x < size; ++x) {
    sum[first + x] = slab.sum[x * nodes + y];
    across[first + x] = slab.across[x * nodes + y];
  }
  transform(slab.fourier, sum);
  transform(slab.fourier, across);
  const float ky = slab.fourier.frequency[y];
  for (int64_t i = 0; i < nodes; ++i) {
    const float kx = slab.fourier.frequency[i], damping = slab.damping[i] * slab.damping[y];
    EACH_ROW {
      const float square = kx * kx + ky * ky + slab.kz[lane] * slab.kz[lane];
      const float factor = square > 0.0f ? damping * slab.damping_z[lane] / square : 0.0f;
      const float re = sum[i].re[lane] + kx * across[i].re[lane], im = sum[i].im[lane] + kx * across[i].im[lane];
      sum[i].re[lane] = factor * im;
      sum[i].im[lane] = -factor * re;
    }
  }
  transform_back(slab.fourier, sum);
  for (int64_t x = 0; x < size; ++x) slab.sum[x * nodes + y] = sum[first + x];
}

// Leave the spectrum of the function in place of the first component's.
HPC_CLONES void integrate_block(Slab& slab, Spectrum* components, int64_t block) {
  const int64_t nodes = slab.fourier.nodes, planes = slab.held.size[0], size = slab.held.size[1];
  slab.begin(block);
  for (int64_t x = 0; x < planes; ++x) transform_plane(slab, components, block, x);
  for (int64_t y = 0; y < nodes; ++y) integrate_column(slab, y);
  for (int64_t x = 0; x < planes; ++x) {
    Element* line = &slab.sum[x * nodes];
    transform_back(slab.fourier, line);
    for (int64_t y = 0; y < size; ++y) components[0].at(x * size + y, block) = line[slab.held.first[1] + y];
  }
}

Output<float> integrate_normals(Doubles places_of, Doubles normals_of, double smoothing, Integers held_of, int64_t nodes,
                                int64_t threads) {
  const double* places = check<double>(places_of, "places", {ANY, 3});
  const int64_t count = rows_of(places_of);
  const double* normals = check<double>(normals_of, "normals", {count, 3});
  if (nodes < 2 || nodes > 1024 || (nodes & (nodes - 1))) refuse("nodes: expected a power of two, 2 to 1024");
  check_positive(smoothing, "smoothing");
  check_finite(places, 3 * count, "places");
  const Held held = take_held(held_of, nodes);
  check_held(places, count, nodes, held);
  const int workers = check_threads(threads);
  auto grid = make_buffer<float>(held.rows() * nodes);
  {
    const Unlocked unlocked;
    const Fourier fourier(nodes);
    const int64_t pairs = (held.rows() + 2 * ROWS - 1) / (2 * ROWS);
    std::vector<Spectrum> components(3, Spectrum(held.rows(), nodes));
    for (int axis = 0; axis < 3; ++axis) {
      spread_component(places, normals + axis, count, nodes, held, grid.get());
      run_ranges(pairs, workers, [&](int64_t begin, int64_t end) {
        transform_rows(fourier, grid.get(), held.rows(), begin, end, components[axis]);
      });
    }
    run_ranges(components[0].blocks, workers, [&](int64_t start, int64_t stop) {
      Slab slab(fourier, held, smoothing);
      for (int64_t block = start; block < stop; ++block) integrate_block(slab, components.data(), block);
    });
    run_ranges(pairs, workers, [&](int64_t begin, int64_t end) {
      transform_rows_back(fourier, components[0], held.rows(), begin, end, grid.get());
    });
  }
  return give(std::move(grid), {static_cast<size_t>(held.size[0]), static_cast<size_t>(held.size[1]),
                                static_cast<size_t>(nodes)});
}

// Places beyond this are as far as can be: the cast to an index is safe.
constexpr double FARTHEST = 1e12;

int64_t check_side(int64_t side) {
  if (side < 2 || side > 1024) refuse("nodes: expected 2 to 1024");
  return side;
}

Output<double> sample_grid(Input values_of, Doubles places_of) {
  const int64_t side = check_side(values_of.ndim() == 3 ? rows_of(values_of) : 0);
  const float* values = check<float>(values_of, "values", {side, side, side});
  const double* places = check<double>(places_of, "places", {ANY, 3});
  const int64_t count = rows_of(places_of);
  check_finite(places, 3 * count, "places");
  auto samples = make_buffer<double>(count);
  {
    const Unlocked unlocked;
    for (int64_t i = 0; i < count; ++i) {
      double total = 0.0;
      visit_corners(spot_of(places + 3 * i, side), side,
                    [&](int64_t node, double weight) { total += weight * values[node]; });
      samples[i] = total;
    }
  }
  return give(std::move(samples), {static_cast<size_t>(count)});
}

// Interpolate at the corners of a lattice, whose places are made as they are needed.
HPC_CLONES void sample_keys(const float* values, int64_t side, const int64_t* keys, int64_t count, const double* origin,
                            double spacing, double* samples) {
  for (int64_t i = 0; i < count; ++i) {
    const Place corner = unpack(keys[i]);
    double place[3], total = 0.0;
    for (int axis = 0; axis < 3; ++axis)
      place[axis] = std::min(std::max(origin[axis] + spacing * static_cast<double>(corner[axis]), -FARTHEST), FARTHEST);
    visit_corners(spot_of(place, side), side, [&](int64_t node, double weight) { total += weight * values[node]; });
    samples[i] = total;
  }
}

Output<double> sample_corners(Input values_of, Integers keys_of, Doubles origin_of, double spacing) {
  const int64_t side = check_side(values_of.ndim() == 3 ? rows_of(values_of) : 0);
  const float* values = check<float>(values_of, "values", {side, side, side});
  const int64_t* keys = check_keys(keys_of, "keys");
  const double* origin = check<double>(origin_of, "origin", {3});
  const int64_t count = rows_of(keys_of);
  check_finite(origin, 3, "origin");
  check_positive(spacing, "spacing");
  auto samples = make_buffer<double>(count);
  {
    const Unlocked unlocked;
    sample_keys(values, side, keys, count, origin, spacing, samples.get());
  }
  return give(std::move(samples), {static_cast<size_t>(count)});
}

}  // namespace

HPC_KERNELS {
  module.def("integrate_normals", &integrate_normals, "places"_a, "normals"_a, "smoothing"_a, "held"_a, "nodes"_a,
             "threads"_a = 1);
  module.def("sample_corners", &sample_corners, "values"_a, "keys"_a, "origin"_a, "spacing"_a);
  module.def("sample_grid", &sample_grid, "values"_a, "places"_a);
}

}  // namespace hpc
