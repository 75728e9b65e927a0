// Fewer faces: edges collapse in the order of their errors, and what is manifold stays so.
#include <algorithm>

#include "arrays.h"
#include "constants.h"

namespace hpc {
namespace {

using namespace constants::collapse;

struct Vector {
  double x = 0.0, y = 0.0, z = 0.0;
};

Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vector operator*(double s, Vector a) { return {s * a.x, s * a.y, s * a.z}; }
double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vector cross(Vector a, Vector b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// The squared distance from planes through the origin, as a symmetric matrix.
struct Planes {
  double xx = 0.0, xy = 0.0, xz = 0.0, yy = 0.0, yz = 0.0, zz = 0.0;

  void add(double weight, Vector n) {
    const Vector m = weight * n;
    xx += m.x * n.x, xy += m.x * n.y, xz += m.x * n.z, yy += m.y * n.y, yz += m.y * n.z, zz += m.z * n.z;
  }
  void add(double sign, const Planes& o) {
    xx += sign * o.xx, xy += sign * o.xy, xz += sign * o.xz;
    yy += sign * o.yy, yz += sign * o.yz, zz += sign * o.zz;
  }
  Vector times(Vector d) const {
    return {xx * d.x + xy * d.y + xz * d.z, xy * d.x + yy * d.y + yz * d.z, xz * d.x + yz * d.y + zz * d.z};
  }
};

// The same of planes anywhere: d A d + 2 b d + c at the offset d.
struct Quadric {
  Planes planes;
  Vector slope;
  double rest = 0.0;

  double at(Vector d) const { return dot(d, planes.times(d)) + 2.0 * dot(slope, d) + rest; }
  Quadric seen_from(Vector d) const { return {planes, slope + planes.times(d), at(d)}; }
  void add(const Quadric& o) { planes.add(1.0, o.planes), slope = slope + o.slope, rest += o.rest; }
};

// Where a quadric is least; its planes must be positive definite, or the origin is returned.
Vector find_least(const Planes& m, Vector slope) {
  if (!(m.xx > 0.0)) return {};
  const double l = m.xy / m.xx, k = m.xz / m.xx;
  const double second = m.yy - l * m.xy, mixed = m.yz - l * m.xz, j = mixed / second;
  const double third = m.zz - k * m.xz - j * mixed;
  if (!(second > 0.0 && third > 0.0)) return {};
  const double v = l * slope.x - slope.y, w = k * slope.x - slope.z - j * v;
  const double z = w / third, y = v / second - j * z;
  return {-slope.x / m.xx - l * y - k * z, y, z};
}

struct Candidate {
  double cost;
  int32_t low, high, stamp;

  bool operator<(const Candidate& o) const {  // the least is the top of a heap
    return cost != o.cost ? cost > o.cost : low != o.low ? low > o.low : high > o.high;
  }
};

class Mesh {
 public:
  Mesh(const double* vertices, int64_t count, const int64_t* faces, int64_t face_count, double limit, bool keeps_border)
      : limit_(limit), is_bounded_(std::isfinite(limit)), place_(count), history_(count), around_(count),
        first_(count, -1), last_(count, -1), valence_(count, 0), stamp_(count, 0), mark_(count, 0), after_(count, -1),
        is_stuck_(count, 0), is_border_(count, 0), is_fixed_(count, 0), corner_(3 * face_count),
        next_(3 * face_count, -1), is_gone_(face_count, 0), face_count_(face_count) {
    for (int64_t v = 0; v < count; ++v) place_[v] = {vertices[3 * v], vertices[3 * v + 1], vertices[3 * v + 2]};
    for (int64_t c = 0; c < 3 * face_count; ++c) {
      const int32_t v = corner_[c] = static_cast<int32_t>(faces[c]);
      (first_[v] < 0 ? first_[v] : next_[last_[v]]) = static_cast<int32_t>(c);
      last_[v] = static_cast<int32_t>(c);
      ++valence_[v];
    }
    for (int32_t v = 0; v < count; ++v) survey(v);
    if (keeps_border) is_fixed_ = is_border_;
    for (int32_t f = 0; f < face_count; ++f) count_face(f, 1.0);
    for (int64_t v = 0; v < count; ++v) {
      history_[v].planes = around_[v];
      Planes& held = history_[v].planes;  // planes alone would let a tip of the border draw back
      if (is_bounded_ && is_border_[v]) held.xx += 1.0, held.yy += 1.0, held.zz += 1.0;
    }
    heap_.reserve(most_candidates());
  }

  // Collapse edges until so many faces are left. What was turned down may fit when all around it has
  // changed: the edges come again, while that takes a thousandth of the faces.
  void simplify(int64_t goal) {
    int64_t before;
    do {
      before = face_count_;
      fill();
      for (int64_t seen = 0; face_count_ > goal && !heap_.empty(); ++seen) {
        if (seen % 4096 == 0) poll();
        std::pop_heap(heap_.begin(), heap_.end());
        const Candidate edge = heap_.back();
        heap_.pop_back();
        if (is_current(edge)) collapse(edge);
        if (static_cast<int64_t>(heap_.size()) > most_candidates()) sweep();
      }
    } while (face_count_ > goal && before - face_count_ > before / 1000);
  }

  // Return the vertices, the faces, which vertex each was, and how many pieces were dropped.
  nb::tuple give_rest() const {
    std::vector<int32_t> row(place_.size(), -1);
    int64_t used = 0, faces = 0;
    for (size_t v = 0; v < place_.size(); ++v)
      if (valence_[v]) row[v] = static_cast<int32_t>(used++);
    auto vertices = make_buffer<double>(3 * used);
    auto sources = make_buffer<int64_t>(used);
    auto corners = make_buffer<int64_t>(3 * face_count_);
    for (size_t v = 0; v < place_.size(); ++v) {
      if (row[v] < 0) continue;
      double* place = vertices.get() + 3 * row[v];
      place[0] = place_[v].x, place[1] = place_[v].y, place[2] = place_[v].z;
      sources[row[v]] = static_cast<int64_t>(v);
    }
    for (size_t c = 0; c < corner_.size(); ++c)
      if (!is_gone_[c / 3]) corners[faces++] = row[corner_[c]];
    return nb::make_tuple(give(std::move(vertices), {static_cast<size_t>(used), 3}),
                          give(std::move(corners), {static_cast<size_t>(face_count_), 3}),
                          give(std::move(sources), {static_cast<size_t>(used)}), dropped_);
  }

 private:
  static int32_t ahead(int32_t c) { return c % 3 == 2 ? c - 2 : c + 1; }
  static int32_t behind(int32_t c) { return c % 3 == 0 ? c + 2 : c - 1; }
  int32_t head(int32_t c) const { return corner_[ahead(c)]; }
  int32_t tail(int32_t c) const { return corner_[behind(c)]; }
  bool is_at(int32_t f, int32_t v) const {
    return corner_[3 * f] == v || corner_[3 * f + 1] == v || corner_[3 * f + 2] == v;
  }

  // The corner at or after c in the list of its vertex whose face is there; -1 at the end.
  int32_t skip(int32_t c) const {
    while (c >= 0 && is_gone_[c / 3]) c = next_[c];
    return c;
  }
  int32_t begin(int32_t v) const { return skip(first_[v]); }
  int32_t step(int32_t c) const { return skip(next_[c]); }

  // Tell whether the faces around a vertex are one ring or, at a border, one fan; if not, no edge at
  // it collapses.
  void survey(int32_t v) {
    if (!valence_[v]) return;
    is_stuck_[v] = !std::isfinite(place_[v].x + place_[v].y + place_[v].z);
    const int32_t heads = ++tick_;  // marks those with a neighbour after them; `tick_`: one before, too
    for (int32_t c = begin(v); c >= 0; c = step(c)) {
      is_stuck_[v] |= head(c) == v || tail(c) == v || head(c) == tail(c) || mark_[head(c)] == heads;
      mark_[head(c)] = heads;
      after_[head(c)] = tail(c);
    }
    ++tick_;
    for (int32_t c = begin(v); c >= 0; c = step(c))
      if (mark_[tail(c)] == heads) mark_[tail(c)] = tick_;
    int32_t start = head(begin(v)), fans = 0, steps = 0;
    for (int32_t c = begin(v); c >= 0; c = step(c))
      if (mark_[head(c)] == heads) start = head(c), ++fans;
    int32_t at = start;
    do at = after_[at], ++steps;
    while (steps < valence_[v] && at != start && mark_[at] >= heads);
    is_border_[v] = fans > 0;
    is_stuck_[v] |= fans > 1 || steps != valence_[v] || (fans ? mark_[at] >= heads : at != start);
  }

  // The number of faces at an edge.
  int32_t count_sides(int32_t v, int32_t w) const {
    if (valence_[w] < valence_[v]) std::swap(v, w);
    int32_t sides = 0;
    for (int32_t c = begin(v); c >= 0; c = step(c)) sides += head(c) == w || tail(c) == w;
    return sides;
  }

  // Add what a face, and its open sides, say of where its vertices may be, or take it away.
  void count_face(int32_t f, double sign) {
    const int32_t* v = &corner_[3 * f];
    const Vector across = cross(place_[v[1]] - place_[v[0]], place_[v[2]] - place_[v[0]]);
    const double length = std::sqrt(dot(across, across));
    if (!(length > TINY)) return;
    const Vector normal = {across.x / length, across.y / length, across.z / length};
    Planes face;
    face.add(is_bounded_ ? 1.0 : length, normal);
    for (int k = 0; k < 3; ++k) around_[v[k]].add(sign, face);
    for (int k = 0; k < 3; ++k) {
      const int32_t a = v[k], b = v[(k + 1) % 3];
      if (!is_border_[a] || !is_border_[b] || count_sides(a, b) != 1) continue;
      const Vector wall = cross(place_[b] - place_[a], normal);
      const double size = dot(wall, wall);
      if (!(size > TINY)) continue;
      Planes side;
      side.add((is_bounded_ ? 1.0 : BORDER * size) / size, wall);
      around_[a].add(sign, side);
      around_[b].add(sign, side);
    }
  }

  Quadric sum_planes(int32_t v) const {
    Quadric sum = history_[v];
    if (!is_bounded_) sum.planes.add(1.0, around_[v]);
    return sum;
  }

  // Find where the vertex of a collapsed edge belongs; return what that costs.
  double find_place(int32_t a, int32_t b, Vector& place) const {
    const Vector edge = place_[b] - place_[a], half = 0.5 * edge;
    Quadric sum = sum_planes(a).seen_from(half);
    sum.add(sum_planes(b).seen_from(-1.0 * half));
    const double weight = sum.planes.xx + sum.planes.yy + sum.planes.zz, soft = SOFT * weight;
    bool is_a = is_fixed_[a], is_b = is_fixed_[b];
    if (!is_a && !is_b) is_a = is_border_[a] > is_border_[b], is_b = is_border_[b] > is_border_[a];
    Vector offset = is_a ? -1.0 * half : half;
    if (!is_a && !is_b) {
      Planes held = sum.planes;
      held.xx += soft, held.yy += soft, held.zz += soft;
      offset = find_least(held, sum.slope);
    }
    place = is_a ? place_[a] : is_b ? place_[b] : place_[a] + half + offset;
    const double error = std::max(sum.at(offset), 0.0) + soft * (dot(offset, offset) + dot(half, half));
    return is_bounded_ || !(error > 0.0) ? error : error * std::sqrt(error / weight);
  }

  void propose(int32_t a, int32_t b) {
    if (is_stuck_[a] || is_stuck_[b] || (is_fixed_[a] && is_fixed_[b])) return;
    if (a > b) std::swap(a, b);
    Vector place;
    const double cost = find_place(a, b, place);
    if (cost < limit_) heap_.push_back({cost, a, b, stamp_[a] + stamp_[b]});
  }

  // Collect the neighbours of a vertex.
  const std::vector<int32_t>& find_ring(int32_t v) {
    ++tick_;
    ring_.clear();
    for (int32_t c = begin(v); c >= 0; c = step(c))
      for (const int32_t w : {head(c), tail(c)})
        if (mark_[w] != tick_) mark_[w] = tick_, ring_.push_back(w);
    return ring_;
  }

  void fill() {
    heap_.clear();
    for (int32_t v = 0; v < static_cast<int32_t>(place_.size()); ++v)
      for (const int32_t w : find_ring(v))
        if (v < w) propose(v, w);
    std::make_heap(heap_.begin(), heap_.end());
  }

  // Twice as many as there are edges, so that a sweep takes half of them.
  int64_t most_candidates() const { return 3 * face_count_ + MOST_FACES; }

  bool is_current(const Candidate& edge) const {
    return valence_[edge.low] && valence_[edge.high] && stamp_[edge.low] + stamp_[edge.high] == edge.stamp;
  }

  // Forget the edges that have changed since they were put down.
  void sweep() {
    heap_.erase(std::remove_if(heap_.begin(), heap_.end(), [&](const Candidate& e) { return !is_current(e); }),
                heap_.end());
    std::make_heap(heap_.begin(), heap_.end());
  }

  void collapse(const Candidate& edge) {
    const int32_t a = is_fixed_[edge.high] ? edge.high : edge.low, b = edge.low + edge.high - a;  // a stays
    if (valence_[a] + valence_[b] > MOST_FACES) return;
    if (is_tetrahedron(a)) return drop(edge);
    Vector place;
    find_place(a, b, place);
    if (!stays_manifold(a, b) || turns_over(a, b, place) || turns_over(b, a, place)) return;
    merge(a, b, place);
    for (const int32_t w : find_ring(a)) {
      const size_t before = heap_.size();
      propose(a, w);
      if (heap_.size() > before) std::push_heap(heap_.begin(), heap_.end());
    }
  }

  // Tell whether a vertex is one of four that are a piece of their own.
  bool is_tetrahedron(int32_t v) {
    const auto is_tip = [&](int32_t w) { return valence_[w] == 3 && !is_border_[w] && !is_stuck_[w]; };
    const std::vector<int32_t>& ring = find_ring(v);
    return is_tip(v) && std::all_of(ring.begin(), ring.end(), is_tip);
  }

  // A tetrahedron cannot shrink but to a point, which moves all of it; then nothing of it is left.
  void drop(const Candidate& edge) {
    if (is_bounded_) return;
    double across = 0.0, longest = 0.0;
    std::vector<int32_t> all = find_ring(edge.low);
    all.push_back(edge.low);
    for (const int32_t v : all)
      for (int32_t c = begin(v); c >= 0; c = step(c)) {
        const Vector side = place_[head(c)] - place_[v], other = place_[tail(c)] - place_[v];
        const Vector normal = cross(side, other);
        across += std::sqrt(dot(normal, normal));
        longest = std::max(longest, dot(side, side));
      }
    const double cost = across * longest * std::sqrt(longest);  // each face was met three times: once for each vertex
    if (edge.cost < cost) {
      heap_.push_back({cost, edge.low, edge.high, edge.stamp});
      std::push_heap(heap_.begin(), heap_.end());
      return;
    }
    for (const int32_t v : all) {
      for (int32_t c = begin(v); c >= 0; c = next_[c]) is_gone_[c / 3] = 1;
      valence_[v] = 0;
    }
    face_count_ -= 4;
    ++dropped_;
  }

  // The link condition: the neighbours that both ends have are those of their common faces alone.
  // What lies beyond a fixed border may come to have an edge or a face there, too: none is made of
  // fixed vertices alone.
  bool stays_manifold(int32_t a, int32_t b) {
    int32_t sides = 0, common = 0;
    for (int32_t c = begin(a); c >= 0; c = step(c)) {
      if (head(c) != b && tail(c) != b) continue;
      if (is_stuck_[head(c) == b ? tail(c) : head(c)]) return false;
      ++sides;
    }
    find_ring(a);
    for (int32_t c = begin(b); c >= 0; c = step(c)) {
      const bool stays = head(c) != a && tail(c) != a;
      if (is_fixed_[a] && stays && is_fixed_[head(c)] && is_fixed_[tail(c)]) return false;
      for (const int32_t w : {head(c), tail(c)})
        if (mark_[w] == tick_) mark_[w] = -tick_, ++common;
        else if (mark_[w] != -tick_ && w != a && is_fixed_[a] && is_fixed_[w]) return false;
    }
    if (common != sides) return false;
    return sides == 2 ? !(is_border_[a] && is_border_[b]) : valence_[a] + valence_[b] > 2;
  }

  // Tell whether a face at v, and not at w, would turn by more than most when v moves.
  bool turns_over(int32_t v, int32_t w, Vector place) const {
    for (int32_t c = begin(v); c >= 0; c = step(c)) {
      if (head(c) == w || tail(c) == w) continue;
      const Vector s = place_[head(c)], t = place_[tail(c)];
      const Vector before = cross(s - place_[v], t - place_[v]), now = cross(s - place, t - place);
      const double lengths = std::sqrt(dot(before, before)) * std::sqrt(dot(now, now));
      if (lengths > 0.0 ? !(dot(before, now) > LEAST_COSINE * lengths) : dot(before, before) > 0.0) return true;
    }
    return false;
  }

  void merge(int32_t a, int32_t b, Vector place) {
    for (int32_t c = begin(a); !is_bounded_ && c >= 0; c = step(c)) count_face(c / 3, -1.0);
    for (int32_t c = begin(b); !is_bounded_ && c >= 0; c = step(c))
      if (!is_at(c / 3, a)) count_face(c / 3, -1.0);
    Quadric sum = history_[a].seen_from(place - place_[a]);
    sum.add(history_[b].seen_from(place - place_[b]));
    history_[a] = sum;
    place_[a] = place;
    for (int32_t c = begin(b); c >= 0; c = step(c)) {
      if (is_at(c / 3, a)) {
        is_gone_[c / 3] = 1;
        --face_count_;
        for (int k = 0; k < 3; ++k) --valence_[corner_[3 * (c / 3) + k]];
      } else {
        corner_[c] = a;
        ++valence_[a];
      }
    }
    valence_[b] = 0;
    next_[last_[a]] = first_[b];
    last_[a] = last_[b];
    relink(a);
    stamp_[a] += stamp_[b] + 1;
    is_border_[a] |= is_border_[b];
    is_fixed_[a] |= is_fixed_[b];
    around_[a] = {};
    for (int32_t c = begin(a); !is_bounded_ && c >= 0; c = step(c)) count_face(c / 3, 1.0);
  }

  // Leave out of the list of a vertex what is gone.
  void relink(int32_t v) {
    int32_t kept = -1;
    for (int32_t c = begin(v); c >= 0; c = step(c)) {
      (kept < 0 ? first_[v] : next_[kept]) = c;
      kept = c;
    }
    last_[v] = kept;
    (kept < 0 ? first_[v] : next_[kept]) = -1;
  }

  double limit_;
  bool is_bounded_;
  std::vector<Vector> place_;
  std::vector<Quadric> history_;
  std::vector<Planes> around_;
  std::vector<int32_t> first_, last_, valence_, stamp_, mark_, after_;
  std::vector<uint8_t> is_stuck_, is_border_, is_fixed_;
  std::vector<int32_t> corner_, next_;
  std::vector<uint8_t> is_gone_;
  int64_t face_count_, dropped_ = 0;
  int32_t tick_ = 0;
  std::vector<int32_t> ring_;
  std::vector<Candidate> heap_;
};

nb::tuple collapse_edges(Doubles vertices_of, Integers faces_of, int64_t goal, double limit, bool keeps_border) {
  const double* vertices = check<double>(vertices_of, "vertices", {ANY, 3});
  const int64_t count = rows_of(vertices_of);
  const int64_t* faces = check_faces(faces_of, count);
  if (!(limit > 0.0)) refuse("limit: expected a positive number");
  std::unique_ptr<Mesh> mesh;
  {
    const Unlocked unlocked;
    mesh = std::make_unique<Mesh>(vertices, count, faces, rows_of(faces_of), limit, keeps_border);
    mesh->simplify(goal);
  }
  return mesh->give_rest();
}

}  // namespace

HPC_KERNELS {
  module.def("collapse_edges", &collapse_edges, "vertices"_a, "faces"_a, "goal"_a, "limit"_a, "keeps_border"_a);
}

}  // namespace hpc
