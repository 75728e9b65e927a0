// Vertices moved off the surface, so that the faces balance around it (see balance.py).
#include <nanobind/stl/optional.h>

#include <cmath>
#include <optional>

#include "arrays.h"
#include "constants.h"

namespace hpc {
namespace {

struct Vector {
  double x, y, z;
};

inline Vector operator-(const Vector& a, const Vector& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline double dot(const Vector& a, const Vector& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector cross(const Vector& a, const Vector& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

struct Surface {
  const double* vertices;
  const int64_t* faces;
  int64_t vertex_count, face_count;
  const uint8_t* exponents;  // of the strides that the faces come from; none where all are 1
};

inline Vector at(const double* vertices, int64_t i) {
  return {vertices[3 * i], vertices[3 * i + 1], vertices[3 * i + 2]};
}

// The normal of a face, of twice its area in length.
inline Vector face_cross(const double* vertices, const int64_t* face) {
  const Vector a = at(vertices, face[0]);
  return cross(at(vertices, face[1]) - a, at(vertices, face[2]) - a);
}

using namespace constants::balance;

inline double squared_edge(const Surface& mesh, const int64_t* face, int k) {
  const Vector edge = at(mesh.vertices, face[(k + 1) % 3]) - at(mesh.vertices, face[k]);
  return dot(edge, edge);
}

// Unit normals, each face counting 1 / (product of its two squared edges there): exact on spheres.
void sum_normals(const Surface& mesh, double step, Vector* normals) {
  std::fill(normals, normals + mesh.vertex_count, Vector{0.0, 0.0, 0.0});
  for (int64_t f = 0; f < mesh.face_count; ++f) {
    const int64_t* face = mesh.faces + 3 * f;
    const Vector n = face_cross(mesh.vertices, face);
    const double size = mesh.exponents ? std::ldexp(step, mesh.exponents[f]) : step;
    const double excess = std::max(SLIVER * size * size, 1e-150);
    double squares[3];  // of the edge that leaves each corner
    for (int k = 0; k < 3; ++k) squares[k] = squared_edge(mesh, face, k) + excess;
    for (int k = 0; k < 3; ++k) {
      const double weight = 1.0 / (squares[k] * squares[(k + 2) % 3]);
      Vector& sum = normals[face[k]];
      sum = {sum.x + weight * n.x, sum.y + weight * n.y, sum.z + weight * n.z};
    }
  }
  for (int64_t v = 0; v < mesh.vertex_count; ++v) {
    const double length = std::max(std::sqrt(dot(normals[v], normals[v])), 1e-300);
    normals[v] = {normals[v].x / length, normals[v].y / length, normals[v].z / length};
  }
}

struct Weighted {
  double sum, weight;
};

// Move every vertex along its normal by the mean gap between its faces and the surface.
void shift_vertices(const Surface& mesh, const Vector* normals, double* moved) {
  auto gaps = make_buffer<Weighted>(mesh.vertex_count);
  std::fill(gaps.get(), gaps.get() + mesh.vertex_count, Weighted{0.0, 0.0});
  for (int64_t f = 0; f < mesh.face_count; ++f) {
    const int64_t* face = mesh.faces + 3 * f;
    double rise = 0.0;
    for (int k = 0; k < 3; ++k) {
      const int64_t p = face[k], q = face[(k + 1) % 3];
      rise += dot(normals[q] - normals[p], at(mesh.vertices, q) - at(mesh.vertices, p));
    }
    const Vector n = face_cross(mesh.vertices, face);
    const double area = std::sqrt(dot(n, n));
    for (int k = 0; k < 3; ++k) {
      gaps[face[k]].sum += area * (rise / 24.0);
      gaps[face[k]].weight += area;
    }
  }
  for (int64_t v = 0; v < mesh.vertex_count; ++v) {
    const double shift = gaps[v].sum / std::max(gaps[v].weight, 1e-300);
    moved[3 * v] = mesh.vertices[3 * v] + normals[v].x * shift;
    moved[3 * v + 1] = mesh.vertices[3 * v + 1] + normals[v].y * shift;
    moved[3 * v + 2] = mesh.vertices[3 * v + 2] + normals[v].z * shift;
  }
}

// Put the vertices of faces that turn over back, a few times: what is held may turn others.
void hold_folds(const Surface& mesh, double* moved) {
  std::vector<bool> held(static_cast<size_t>(mesh.vertex_count));
  for (int round = 0; round < ROUNDS; ++round) {
    std::vector<int64_t> folded;
    for (int64_t f = 0; f < mesh.face_count; ++f) {
      const int64_t* face = mesh.faces + 3 * f;
      if (held[face[0]] && held[face[1]] && held[face[2]]) continue;
      if (dot(face_cross(mesh.vertices, face), face_cross(moved, face)) <= 0.0) folded.push_back(f);
    }
    if (folded.empty()) return;
    for (int64_t f : folded)
      for (int k = 0; k < 3; ++k) {
        const int64_t v = mesh.faces[3 * f + k];
        held[v] = true;
        std::copy(mesh.vertices + 3 * v, mesh.vertices + 3 * v + 3, moved + 3 * v);
      }
  }
}

Output<double> balance_vertices(Doubles vertices_of, Integers faces_of, double step,
                                std::optional<Bytes> exponents_of) {
  const int64_t count = vertices_of.ndim() ? rows_of(vertices_of) : 0;
  const Surface mesh{check<double>(vertices_of, "vertices", {ANY, 3}), check_faces(faces_of, count), count,
                     rows_of(faces_of),
                     exponents_of ? check<uint8_t>(*exponents_of, "exponents", {rows_of(faces_of)}) : nullptr};
  check_positive(step, "step");
  auto moved = make_buffer<double>(3 * count);
  {
    const Unlocked unlocked;
    const auto normals = make_buffer<Vector>(count);
    sum_normals(mesh, step, normals.get());
    shift_vertices(mesh, normals.get(), moved.get());
    hold_folds(mesh, moved.get());
  }
  return give(std::move(moved), {static_cast<size_t>(count), 3});
}

}  // namespace

HPC_KERNELS {
  module.def("balance_vertices", &balance_vertices, "vertices"_a, "faces"_a, "step"_a,
             "exponents"_a.none() = nb::none());
}

}  // namespace hpc
