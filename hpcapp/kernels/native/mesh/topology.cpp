// The connectivity of a mesh: components, edges, and the fans of faces around vertices.
#include <algorithm>
#include <numeric>

#include "arrays.h"
#include "sets.h"

namespace hpc {
namespace {

nb::tuple label_components(Integers faces_of, int64_t vertices) {
  const int64_t* faces = check_faces(faces_of, vertices);
  const int64_t count = rows_of(faces_of);
  auto label = make_buffer<int32_t>(vertices);
  int64_t components = 0;
  {
    const Unlocked unlocked;
    Sets sets(vertices);
    for (int64_t f = 0; f < 3 * count; f += 3) {
      sets.join(static_cast<int32_t>(faces[f]), static_cast<int32_t>(faces[f + 1]));
      sets.join(static_cast<int32_t>(faces[f]), static_cast<int32_t>(faces[f + 2]));
    }
    components = sets.number(label.get());
  }
  return nb::make_tuple(components, give(std::move(label), {static_cast<size_t>(vertices)}));
}

// One side of a face, filed under its lower vertex.
struct Side {
  int32_t upper, side;
};

// The sides of all faces, grouped by their lower vertex.
struct SideTable {
  std::vector<int32_t> starts;
  std::vector<Side> sides;

  SideTable(const int64_t* faces, int64_t count, int64_t vertices)
      : starts(static_cast<size_t>(vertices) + 1, 0), sides(static_cast<size_t>(3 * count)) {
    for (int64_t s = 0; s < 3 * count; ++s) ++starts[lower(faces, s) + 1];
    std::partial_sum(starts.begin(), starts.end(), starts.begin());
    std::vector<int32_t> at(starts.begin(), starts.end() - 1);
    for (int64_t s = 0; s < 3 * count; ++s) {
      const int64_t low = lower(faces, s), upper = faces[s] + faces[next(s)] - low;
      sides[at[low]++] = {static_cast<int32_t>(upper), static_cast<int32_t>(s)};
    }
    for (int64_t v = 0; v < vertices; ++v)
      std::sort(sides.begin() + starts[v], sides.begin() + starts[v + 1], [](const Side& a, const Side& b) {
        return a.upper != b.upper ? a.upper < b.upper : a.side < b.side;
      });
  }

  static int64_t next(int64_t side) { return side % 3 == 2 ? side - 2 : side + 1; }
  static int64_t lower(const int64_t* faces, int64_t s) { return std::min(faces[s], faces[next(s)]); }
};

struct Survey {
  int64_t edges = 0, boundary = 0, overfull = 0, degenerate = 0, misoriented = 0;
};

// Count what is wrong with one edge's sides, and join the corners at it.
void survey_edge(const int64_t* faces, const Side* sides, int64_t count, int64_t low, Sets& corners, Survey& survey) {
  int64_t backward = 0;
  for (int64_t i = 0; i < count; ++i) backward += faces[sides[i].side] > faces[SideTable::next(sides[i].side)];
  ++survey.edges;
  survey.boundary += count == 1;
  survey.overfull += count > 2;
  survey.degenerate += sides[0].upper == low;
  survey.misoriented += backward > 1 || count - backward > 1;
  if (count < 2) return;
  const int32_t a = sides[0].side, b = sides[1].side;
  const int32_t a_head = static_cast<int32_t>(SideTable::next(a)), b_head = static_cast<int32_t>(SideTable::next(b));
  const bool runs_back = faces[a] == faces[b_head];
  corners.join(a, runs_back ? b_head : b);
  corners.join(a_head, runs_back ? b : b_head);
}

nb::object survey_mesh(Integers faces_of, int64_t vertices) {
  const int64_t* faces = check_faces(faces_of, vertices);
  const int64_t count = rows_of(faces_of);
  auto edges_of = make_buffer<int32_t>(vertices);
  Survey survey;
  int64_t fans = 0;
  {
    const Unlocked unlocked;
    const SideTable table(faces, count, vertices);
    Sets corners(3 * count);
    for (int64_t v = 0; v < vertices; ++v) {
      const int64_t before = survey.edges;
      for (int64_t i = table.starts[v], j; i < table.starts[v + 1]; i = j) {
        for (j = i + 1; j < table.starts[v + 1] && table.sides[j].upper == table.sides[i].upper;) ++j;
        survey_edge(faces, &table.sides[i], j - i, v, corners, survey);
      }
      edges_of[v] = static_cast<int32_t>(survey.edges - before);
    }
    for (int64_t i = 0; i < 3 * count; ++i) fans += corners.find(static_cast<int32_t>(i)) == i;
  }
  return python_object("types.brick_mesh", "Survey")(survey.boundary, survey.overfull, survey.degenerate, survey.misoriented, fans,
                                        give(std::move(edges_of), {static_cast<size_t>(vertices)}));
}

// The volume relative to a reference point, face after face.
double signed_volume(Doubles vertices_of, Integers faces_of, Doubles reference_of) {
  const double* vertices = check<double>(vertices_of, "vertices", {ANY, 3});
  const int64_t* faces = check_faces(faces_of, rows_of(vertices_of));
  const double* reference = check<double>(reference_of, "reference", {3});
  const int64_t count = rows_of(faces_of);
  const Unlocked unlocked;
  double total = 0.0;
  for (int64_t f = 0; f < count; ++f) {
    double corner[3][3];
    for (int k = 0; k < 3; ++k)
      for (int axis = 0; axis < 3; ++axis)
        corner[k][axis] = vertices[3 * faces[3 * f + k] + axis] - reference[axis];
    for (int axis = 0; axis < 3; ++axis) {
      const int next = (axis + 1) % 3, last = (axis + 2) % 3;
      total += corner[0][axis] * (corner[1][next] * corner[2][last] - corner[1][last] * corner[2][next]);
    }
  }
  return total / 6.0;
}

}  // namespace

HPC_KERNELS {
  module.def("label_components", &label_components, "faces"_a, "vertices"_a);
  module.def("survey_mesh", &survey_mesh, "faces"_a, "vertices"_a);
  module.def("signed_volume", &signed_volume, "vertices"_a, "faces"_a, "reference"_a);
}

}  // namespace hpc
