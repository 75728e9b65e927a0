// The implicit function over one brick (see field.py).
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "arrays.h"
#include "keys.h"

namespace hpc {

constexpr int BRICK = 8;
constexpr int NODES = BRICK + 1;
constexpr int BRICK_NODES = NODES * NODES * NODES;

// Quadrics are of single precision, and so are the values of the nodes that come of them.
using Real = float;

struct Grid {
  const double* origin;
  double step;
  int64_t bricks[3];
};

// The quadrics of one lattice.
struct FieldLevel {
  const int64_t* keys;
  int64_t vertices;
  const float *coefficients, *trust;
};

// Those vertices of the finest lattice that have three quadrics, joined by max or min.
struct Features {
  const int64_t* keys;
  int64_t count;
  const float* pieces;
  const uint8_t* joints;
};

struct Field {
  const double* origin;
  double cell_size;
  std::vector<FieldLevel> levels;
  const float* far_values;
  int64_t far_nodes;
  const double* far_origin;
  double far_step;
  Features features;
};

// What every call takes as (origin, step, bricks) and as seven arguments.
Grid take_grid(const Input& origin, double step, const Input& bricks);
Field take_field(const nb::tuple& arguments, const Grid& grid);

class FeatureBlend;

// Evaluates bricks, one after the other; each thread has its own.
class BrickEvaluator {
 public:
  BrickEvaluator(const Field& field, const Grid& grid);
  ~BrickEvaluator();
  // Write the values of all nodes, x slowest.
  void evaluate(const Place& brick, float* values);

 private:
  // Blend a level over what lies in front of it; return whether anything is left to those behind.
  bool add_level(const Place& brick, size_t depth);

  const Field& field_;
  Grid grid_;
  std::vector<Finger> fingers_;
  std::unique_ptr<FeatureBlend> features_;
  std::vector<Real> scratch_;
};

}  // namespace hpc
