// Vertices of a lattice with more than one quadric (see feature_blend.py).
#pragma once

#include <cstdint>

#include "arrays.h"
#include "feature_points.h"
#include "field.h"
#include "layers.h"

namespace hpc {

// Blends what joined quadrics differ by from the one quadric of their vertex.
class FeatureBlend {
 public:
  explicit FeatureBlend(const Features& features) : features_(features), finger_(features.keys, features.count) {}

  // Find the features around a brick, given the layers of the lattice there; return whether there are any.
  bool find(const Axis* axes);

  // Add at the nodes of a brick, [x][plane]; `raw` has the quadrics around it (see field.cpp), `scale` is the size of
  // the lattice's cells, and `before` and `rest` are what is left to the level, and to those behind it.
  void add(const Axis* axes, const Real* raw, int64_t plane, int64_t lanes, Real scale, Real* total,
           const Real* before, const Real* rest, int64_t stride) const;

 private:
  struct Found {
    int at[3];
    int64_t row;
  };
  const Features& features_;
  Finger finger_;
  std::vector<Found> found_;
};

}  // namespace hpc
