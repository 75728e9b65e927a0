// The open seams of a part of a mesh, and what its bricks hold (see seams.py).
#include <nanobind/stl/pair.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "arrays.h"
#include "sets.h"

namespace hpc {
namespace {

// The faces of a part: i >= 0 is a node, i < 0 the foreign vertex ~i, whose node is own + ~i.
struct Faces {
  const int32_t* corners;
  int64_t count;
  int32_t own;

  int32_t node(int64_t corner) const {
    const int32_t i = corners[corner];
    return i < 0 ? own + ~i : i;
  }
  int32_t next(int64_t corner) const { return node(after(corner)); }
  int32_t last(int64_t corner) const { return node(corner % 3 == 0 ? corner + 2 : corner - 1); }
  static int64_t after(int64_t corner) { return corner % 3 == 2 ? corner - 2 : corner + 1; }
};

Faces check_nodes(const Input& faces_of, int64_t own, int64_t foreign, int64_t nodes) {
  const int32_t* corners = check<int32_t>(faces_of, "faces", {ANY, 3});
  const int64_t count = rows_of(faces_of);
  if (own < 0 || foreign < 0 || own >= INT32_MAX || foreign >= INT32_MAX - own || nodes >= INT32_MAX || 3 * count >= INT32_MAX)
    refuse("faces: too many, or too many vertices");
  int32_t lowest = 0, highest = -1;
  for (int64_t c = 0; c < 3 * count; ++c) {
    lowest = std::min(lowest, corners[c]);
    highest = std::max(highest, corners[c]);
  }
  if (highest >= nodes || lowest < -foreign) refuse("faces: a vertex that is not there");
  return {corners, count, static_cast<int32_t>(own)};
}

// The two other nodes of a face as seen from one of its corners, anticlockwise.
struct Link {
  int32_t after, before;
};

// The corners of the faces, grouped by their nodes, and the components of the vertices.
struct Corners {
  std::vector<int32_t> starts;
  Buffer<Link> links;

  Corners(const Faces& faces, const int32_t* vertex_of, int64_t nodes, Sets& labels)
      : starts(static_cast<size_t>(nodes) + 2, 0) {
    for (int64_t c = 0; c < 3 * faces.count; ++c) ++starts[faces.node(c) + 2];
    const int32_t most = *std::max_element(starts.begin(), starts.end());
    std::partial_sum(starts.begin(), starts.end(), starts.begin());
    links = make_buffer<Link>(3 * faces.count + most);
    std::fill(links.get() + 3 * faces.count, links.get() + 3 * faces.count + most, Link{-1, -1});
    // Filling moves every start to the next one's place.
    for (int64_t f = 0; f < 3 * faces.count; f += 3) {
      const int32_t a = faces.node(f), b = faces.node(f + 1), c = faces.node(f + 2);
      labels.join(vertex_of[a], vertex_of[b]);
      labels.join(vertex_of[b], vertex_of[c]);
      links[starts[a + 1]++] = {b, c};
      links[starts[b + 1]++] = {c, a};
      links[starts[c + 1]++] = {a, b};
    }
  }

  const Link* begin(int64_t node) const { return links.get() + starts[node]; }
  int32_t count(int64_t node) const { return starts[node + 1] - starts[node]; }
};

// Tell whether the faces at a node stand around it in one ring. Of links that leave to one node the
// last is found: were there two, the other would be left out and the ring too short. `slots` has a
// place for each node, and holds what other nodes left there: no more than the most links of one.
// No branch depends on where the walk leads, so that the next node's can begin before it ends.
bool is_ring(const Link* links, int32_t count, int32_t self, int32_t* slots) {
  if (!count) return false;
  for (int32_t i = 0; i < count; ++i) slots[links[i].after] = i;
  const int32_t start = links[0].after;
  int32_t at = links[0].before;
  unsigned fits = start != self;
  for (int32_t step = 1; step < count; ++step) {
    const int32_t i = slots[at];
    fits &= static_cast<unsigned>(i < count) & (links[i].after == at) & (at != self) & (at != start);
    at = links[i].before < 0 ? at : links[i].before;
  }
  return fits & (at == start);
}

// A corner at an open node.
struct Open {
  int32_t node, corner;
};

struct Found {
  Sets labels;
  std::vector<uint8_t> closed;
  std::vector<int32_t> pieces, sides, bare;
};

// Tell which nodes are closed, and which no face uses.
void close_nodes(const Corners& corners, const bool* is_open, int64_t count, Found& found) {
  std::vector<int32_t> slots(static_cast<size_t>(count), 0);
  for (int64_t n = 0; n < count; ++n) {
    const Link* links = corners.begin(n);
    const int32_t degree = corners.count(n);
    found.closed[n] = !is_open[n] && is_ring(links, degree, static_cast<int32_t>(n), slots.data());
    if (!degree && !is_open[n]) found.bare.push_back(static_cast<int32_t>(n));
  }
}

// Join the corners at each open node across edges whose other end is closed, and list the sides
// between open nodes.
void join_open(const Faces& faces, Found& found) {
  std::vector<Open> open;
  for (int64_t f = 0; f < 3 * faces.count; f += 3) {
    if (found.closed[faces.node(f)] & found.closed[faces.node(f + 1)] & found.closed[faces.node(f + 2)]) continue;
    for (int64_t c = f; c < f + 3; ++c)
      if (!found.closed[faces.node(c)]) open.push_back({faces.node(c), static_cast<int32_t>(c)});
  }
  std::sort(open.begin(), open.end(),
            [](const Open& a, const Open& b) { return a.node != b.node ? a.node < b.node : a.corner < b.corner; });
  const size_t count = open.size();
  Sets joined(static_cast<int64_t>(count));
  for (size_t i = 0, end; i < count; i = end) {
    for (end = i; end < count && open[end].node == open[i].node;) ++end;
    for (size_t a = i; a < end; ++a) {
      const int32_t across = faces.last(open[a].corner);
      if (!found.closed[across]) continue;
      for (size_t b = i; b < end; ++b)
        if (faces.next(open[b].corner) == across) joined.join(static_cast<int32_t>(a), static_cast<int32_t>(b));
    }
  }
  std::vector<int32_t> piece(count);
  joined.number(piece.data());
  std::vector<std::pair<int32_t, int32_t>> piece_of;  // of each open corner
  for (size_t i = 0; i < count; ++i) {
    if (piece[i] == static_cast<int32_t>(found.pieces.size())) found.pieces.push_back(open[i].node);
    piece_of.emplace_back(open[i].corner, piece[i]);
  }
  std::sort(piece_of.begin(), piece_of.end());
  for (size_t i = 0; i < count; ++i) {
    const int32_t corner = piece_of[i].first, head = static_cast<int32_t>(Faces::after(corner));
    if (found.closed[faces.node(head)]) continue;
    const auto at = std::lower_bound(piece_of.begin(), piece_of.end(), std::make_pair(head, INT32_MIN));
    found.sides.insert(found.sides.end(), {corner, piece_of[i].second, at->second});
  }
}

Output<int32_t> give_list(const std::vector<int32_t>& values, int64_t columns = 0) {
  auto data = make_buffer<int32_t>(static_cast<int64_t>(values.size()));
  std::copy(values.begin(), values.end(), data.get());
  if (!columns) return give(std::move(data), {values.size()});
  return give(std::move(data), {values.size() / static_cast<size_t>(columns), static_cast<size_t>(columns)});
}

const int32_t* check_rows(const Input& rows_of_, const char* name, std::initializer_list<int64_t> shape, int64_t limit) {
  const int32_t* rows = check<int32_t>(rows_of_, name, shape);
  for (size_t i = 0; i < rows_of_.size(); ++i)
    if (rows[i] < 0 || rows[i] >= limit) refuse(std::string(name) + ": a row that is not there");
  return rows;
}

nb::object find_seams(Input faces_of, std::pair<int64_t, int64_t> counts, Input vertex_of_, Input is_open_of) {
  const auto [own, foreign] = counts;
  const bool* is_open = check<bool>(is_open_of, "is_open", {ANY});
  const int64_t count = rows_of(is_open_of);
  const Faces faces = check_nodes(faces_of, own, foreign, count);
  const int64_t vertices = own + foreign;
  if (vertices > count) refuse("is_open: too few nodes");
  const int32_t* vertex_of = check_rows(vertex_of_, "vertex_of", {count}, vertices);
  auto labels = make_buffer<int32_t>(vertices);
  int64_t components = 0;
  Found found{Sets(vertices), std::vector<uint8_t>(static_cast<size_t>(count)), {}, {}, {}};
  {
    const Unlocked unlocked;
    close_nodes(Corners(faces, vertex_of, count, found.labels), is_open, count, found);
    components = found.labels.number(labels.get());
    join_open(faces, found);
  }
  return python_object("types.brick_mesh", "Seams")(components, give(std::move(labels), {static_cast<size_t>(vertices)}),
                                       give_list(found.pieces), give_list(found.sides, 3), give_list(found.bare));
}

// A component in a brick.
struct Entry {
  int32_t label, vertices, faces;
  double sums[5];
};

// Return the area of a triangle.
double area_of(const double* a, const double* b, const double* c) {
  const double u[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]}, v[3] = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
  const double x = u[1] * v[2] - u[2] * v[1], y = u[2] * v[0] - u[0] * v[2], z = u[0] * v[1] - u[1] * v[0];
  return 0.5 * std::sqrt(x * x + y * y + z * z);
}

struct PartView {
  const double* vertices;
  Faces faces;
  const int32_t* labels;
};

// The entries of one brick, in the order in which its vertices and then its faces name them.
class BrickEntries {
 public:
  explicit BrickEntries(std::vector<Entry>& all) : all_(all), first_(all.size()) {}

  Entry& of(int32_t label) {
    for (size_t i = first_; i < all_.size(); ++i)
      if (all_[i].label == label) return all_[i];
    all_.push_back({label, 0, 0, {}});
    return all_.back();
  }

 private:
  std::vector<Entry>& all_;
  size_t first_;
};

// Add the vertices from the first on that belong to its component; return where they end.
int64_t add_vertices(const PartView& part, int64_t first, int64_t end, BrickEntries& entries, double* bounds) {
  const int32_t label = part.labels[first];
  double* const box = bounds + 6 * label;
  double sums[3] = {0.0, 0.0, 0.0}, low[3] = {box[0], box[1], box[2]}, high[3] = {box[3], box[4], box[5]};
  int64_t i = first;
  for (; i < end && part.labels[i] == label; ++i)
    for (int axis = 0; axis < 3; ++axis) {
      const double coordinate = part.vertices[3 * i + axis];
      sums[axis] += coordinate;
      low[axis] = std::min(low[axis], coordinate);
      high[axis] = std::max(high[axis], coordinate);
    }
  Entry& entry = entries.of(label);
  entry.vertices += static_cast<int32_t>(i - first);
  for (int axis = 0; axis < 3; ++axis) {
    entry.sums[1 + axis] += sums[axis];
    box[axis] = low[axis];
    box[3 + axis] = high[axis];
  }
  return i;
}

// Add the faces from the first on that belong to its component; return where they end.
int64_t add_faces(const PartView& part, int64_t first, int64_t end, BrickEntries& entries) {
  const int32_t label = part.labels[part.faces.node(3 * first)];
  double volume = 0.0, area = 0.0;
  int64_t i = first;
  for (; i < end && part.labels[part.faces.node(3 * i)] == label; ++i) {
    const int32_t* face = part.faces.corners + 3 * i;
    if (face[0] < 0 || face[1] < 0 || face[2] < 0) continue;
    const double *a = part.vertices + 3 * int64_t{face[0]}, *b = part.vertices + 3 * int64_t{face[1]},
                 *c = part.vertices + 3 * int64_t{face[2]};
    volume += a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
    area += area_of(a, b, c);
  }
  Entry& entry = entries.of(label);
  entry.faces += static_cast<int32_t>(i - first);
  entry.sums[0] += volume;
  entry.sums[4] += area;
  return i;
}

int64_t sum_counts(const int32_t* counts, int64_t bricks, const char* name) {
  int64_t total = 0;
  for (int64_t b = 0; b < bricks; ++b) {
    if (counts[b] < 0) refuse(std::string(name) + ": a negative count");
    total += counts[b];
  }
  return total;
}

nb::object give_sums(Buffer<int32_t> starts, int64_t bricks, const std::vector<Entry>& entries, Buffer<double> bounds,
                     int64_t components) {
  const int64_t count = static_cast<int64_t>(entries.size());
  auto labels = make_buffer<int32_t>(count), vertices = make_buffer<int32_t>(count), faces = make_buffer<int32_t>(count);
  auto sums = make_buffer<double>(5 * count);
  for (int64_t e = 0; e < count; ++e) {
    labels[e] = entries[e].label;
    vertices[e] = entries[e].vertices;
    faces[e] = entries[e].faces;
    std::copy(entries[e].sums, entries[e].sums + 5, sums.get() + 5 * e);
  }
  const size_t rows = entries.size();
  return python_object("types.brick_mesh", "BrickSums")(
      give(std::move(starts), {static_cast<size_t>(bricks) + 1}), give(std::move(labels), {rows}),
      give(std::move(vertices), {rows}), give(std::move(faces), {rows}), give(std::move(sums), {rows, 5}),
      give(std::move(bounds), {static_cast<size_t>(components), 6}));
}

nb::object sum_bricks(Doubles vertices_of, Input faces_of, std::pair<Input, Input> counts_of, Input labels_of,
                      int64_t components) {
  const double* vertices = check<double>(vertices_of, "vertices", {ANY, 3});
  if (components < 0 || labels_of.ndim() != 1 || components > rows_of(labels_of)) refuse("components: expected a count");
  const int32_t* labels = check_rows(labels_of, "labels", {ANY}, components);
  const int64_t own = rows_of(vertices_of), all = rows_of(labels_of);
  if (own > all) refuse("labels: too few");
  const Faces faces = check_nodes(faces_of, own, all - own, own);
  const int32_t* vertex_counts = check<int32_t>(counts_of.first, "vertex_counts", {ANY});
  const int64_t bricks = rows_of(counts_of.first);
  const int32_t* face_counts = check<int32_t>(counts_of.second, "face_counts", {bricks});
  if (sum_counts(vertex_counts, bricks, "vertex_counts") != own ||
      sum_counts(face_counts, bricks, "face_counts") != faces.count)
    refuse("counts: they do not add up");
  const PartView part{vertices, faces, labels};
  auto starts = make_buffer<int32_t>(bricks + 1);
  auto bounds = make_buffer<double>(6 * components);
  std::vector<Entry> entries;
  {
    const Unlocked unlocked;
    for (int64_t i = 0; i < 6 * components; ++i) {
      const double infinity = std::numeric_limits<double>::infinity();
      bounds[i] = i % 6 < 3 ? infinity : -infinity;
    }
    int64_t vertex = 0, face = 0;
    for (int64_t b = 0; b < bricks; ++b) {
      starts[b] = static_cast<int32_t>(entries.size());
      BrickEntries of_brick(entries);
      for (const int64_t end = vertex + vertex_counts[b]; vertex < end;)
        vertex = add_vertices(part, vertex, end, of_brick, bounds.get());
      for (const int64_t end = face + face_counts[b]; face < end;)
        face = add_faces(part, face, end, of_brick);
    }
    starts[bricks] = static_cast<int32_t>(entries.size());
  }
  return give_sums(std::move(starts), bricks, entries, std::move(bounds), components);
}

}  // namespace

HPC_KERNELS {
  module.def("find_seams", &find_seams, "faces"_a, "counts"_a, "vertex_of"_a, "is_open"_a);
  module.def("sum_bricks", &sum_bricks, "vertices"_a, "faces"_a, "counts"_a, "labels"_a, "components"_a);
}

}  // namespace hpc
