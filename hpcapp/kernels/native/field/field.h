// The implicit function over one brick (see field.py).
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "arrays.h"
#include "lattice/keys.h"
#include "strides.h"

namespace hpc {

// Quadrics are of single precision, and so are the values of the nodes that come of them.
using Real = float;

// The quadrics of one lattice.
struct FieldLevel {
  const int64_t* keys;
  int64_t vertices;
  const float *coefficients, *trust;
};

// Those vertices of a lattice that have three quadrics, joined by max or min.
struct Features {
  const int64_t* keys = nullptr;
  int64_t count = 0;
  const float* pieces = nullptr;
  const uint8_t* joints = nullptr;
};

struct Field {
  double origin[3], cell_size;
  std::vector<FieldLevel> levels;
  const float* far_values;
  int64_t far_nodes;
  double far_origin[3], far_step;
  const double* hull;  // planes: normals and distances from the origin
  int64_t planes;
  std::vector<Features> features;  // of the first levels
  std::vector<Input> arrays;  // what the pointers above point into

  // Return an array of a record, and hold it.
  template <class Array>
  Input hold(nb::handle record, const char* name) {
    arrays.push_back(field_of<Array>(record, name));
    return arrays.back();
  }
};

// Check a `Field` of Python.
Field take_field(nb::handle given, const Grid& grid);

class FeatureBlend;

// Evaluates bricks, one after the other; each thread has its own.
class BrickEvaluator {
 public:
  BrickEvaluator(const Field& field, const Grid& grid);
  ~BrickEvaluator();
  // Write the values of every so many nodes along each axis, x slowest.
  void evaluate(const Place& brick, int every, float* values);

 private:
  // Blend a level over what lies in front of it; return whether anything is left to those behind.
  bool add_level(const Place& brick, int every, size_t depth);

  const Field& field_;
  const Grid& grid_;
  std::vector<Finger> fingers_;
  std::vector<FeatureBlend> features_;
  std::vector<Real> scratch_;
};

}  // namespace hpc
