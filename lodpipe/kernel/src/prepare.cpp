// From the input arrays to the state: order, scale, adjacency, first quadrics.
#include "prepare.h"

#include <cmath>
#include <numeric>

#include "pairs.h"

namespace lodpipe {
namespace {

constexpr int kGrain = 2048;
constexpr size_t kSmallFan = 32;

void fit_unit_box(const Input& in, State& s) {
  double lo[3], hi[3];
  for (int k = 0; k < 3; ++k) lo[k] = hi[k] = in.vertex_count ? in.positions[k] : 0;
  for (int64_t i = 0; i < in.vertex_count; ++i)
    for (int k = 0; k < 3; ++k) {
      lo[k] = std::min(lo[k], in.positions[3 * i + k]);
      hi[k] = std::max(hi[k], in.positions[3 * i + k]);
    }
  // halves first: the difference itself may overflow for coordinates near the limit
  const double half = std::hypot(hi[0] / 2 - lo[0] / 2, hi[1] / 2 - lo[1] / 2, hi[2] / 2 - lo[2] / 2);
  for (int k = 0; k < 3; ++k) s.center[k] = lo[k] / 2 + hi[k] / 2;
  s.scale = half > 0 ? 0.5 / half : 1;
}

// Vertices along a Morton curve, faces by their first vertex along it, wedges by their first face.
std::vector<int32_t> order_all(const Input& in, State& s) {
  const int count = in.vertex_count;
  std::vector<Keyed> keys(count), scratch;
  std::vector<Vec3> at(count);
  for (int i = 0; i < count; ++i) {
    const double* p = in.positions + 3 * static_cast<int64_t>(i);
    at[i] = {static_cast<float>((p[0] - s.center[0]) * s.scale), static_cast<float>((p[1] - s.center[1]) * s.scale),
             static_cast<float>((p[2] - s.center[2]) * s.scale)};
    keys[i] = {morton(at[i] * 2), i};
  }
  radix_sort(keys, scratch);
  std::vector<int32_t> rank(count);
  s.vertices.resize(count);
  s.vertex_source.resize(count);
  for (int i = 0; i < count; ++i) {
    rank[keys[i].id] = i;
    s.vertex_source[i] = keys[i].id;
    s.vertices[i] = Vertex{at[keys[i].id], {}, kNone, kDirty, 0, 0, 0};
  }
  return rank;
}

void place_faces(const Input& in, const std::vector<int32_t>& rank, State& s) {
  std::vector<int32_t> start(static_cast<size_t>(in.vertex_count) + 1, 0);
  const auto first = [&](int64_t f) {
    const int32_t* v = in.faces + 3 * f;
    return std::min({rank[v[0]], rank[v[1]], rank[v[2]]});
  };
  const auto flat = [&](int64_t f) {
    const int32_t* v = in.faces + 3 * f;
    return v[0] == v[1] || v[1] == v[2] || v[0] == v[2];
  };
  for (int64_t f = 0; f < in.face_count; ++f)
    if (!flat(f)) ++start[first(f) + 1];
  std::partial_sum(start.begin(), start.end(), start.begin());
  s.triangles = start.back();
  s.faces.resize(s.triangles);
  for (int64_t f = 0; f < in.face_count; ++f) {
    if (flat(f)) continue;
    const int32_t* v = in.faces + 3 * f;
    const int32_t* w = in.wedges + 3 * f;
    s.faces[start[first(f)]++] = {{rank[v[0]], rank[v[1]], rank[v[2]]}, {w[0], w[1], w[2]}, {}, static_cast<int32_t>(f)};
  }
}

void place_wedges(const Input& in, const Options& options, State& s) {
  std::vector<int32_t> number(in.wedge_count, kNone);
  for (Face& f : s.faces)
    for (int32_t& w : f.w) {
      if (number[w] == kNone) {
        number[w] = static_cast<int32_t>(s.wedge_source.size());
        s.wedge_source.push_back(w);
      }
      w = number[w];
    }
  s.columns = in.columns;
  for (int pass = 0; pass < 2; ++pass) {
    for (int k = 0; k < in.columns; ++k) {
      const bool steers = options.attribute_cost && in.column_weights[k] > 0;
      if (steers == (pass == 0)) {
        s.column_source.push_back(k);
        s.column_scale.push_back(steers ? static_cast<float>(in.column_weights[k] * s.scale) : 1.0f);
      }
    }
    if (pass == 0) s.steering = static_cast<int>(s.column_source.size());
  }
  const size_t count = s.wedge_source.size();
  if (!s.columns) return;
  s.value.resize(count * s.columns);
  s.slope.resize(count * s.columns);
  s.weight.resize(count);
  s.wedge_moved.resize(count);
  for (size_t i = 0; i < count; ++i)
    for (int k = 0; k < s.columns; ++k)
      s.value[i * s.columns + k] =
          in.values[static_cast<size_t>(s.wedge_source[i]) * s.columns + s.column_source[k]] * s.column_scale[k];
}

void link_corners(State& s) {
  // from behind, so that each list starts with its vertex's first face
  for (int64_t f = static_cast<int64_t>(s.faces.size()) - 1; f >= 0; --f)
    for (int k = s.faces[f].link() ? 1 : 2; k >= 0; --k) {
      Vertex& v = s.vertices[s.faces[f].v[k]];
      s.faces[f].next[k] = v.head;
      v.head = corner(static_cast<int32_t>(f), k);
    }
}

// Quadrics of one vertex, from the faces round it.
class FirstQuadrics {
 public:
  FirstQuadrics(const Input& in, const Options& options, State& s) : in_(in), options_(options), s_(s) {}

  void operator()(int v) {
    Vertex& a = s_.vertices[v];
    ring_.clear();
    int32_t wedge = kNone;
    for (int32_t c = a.head; c != kNone; c = s_.faces[face_of(c)].next[slot_of(c)]) {
      const Face& f = s_.faces[face_of(c)];
      if (f.link()) {
        a.flags |= kIrregular;
        continue;
      }
      const int k = slot_of(c);
      if (wedge != kNone && wedge != f.w[k]) a.flags |= kSeveralWedges;
      wedge = f.w[k];
      const int i = (k + 1) % 3, j = (k + 2) % 3;
      Spoke p{f.v[i], f.v[j], f.w[k], f.w[i], f.w[j], {}, 0};
      const Vec3 e1 = s_.vertices[p.next].p - a.p, e2 = s_.vertices[p.previous].p - a.p;
      const Vec3 n = cross(e1, e2);
      const float twice = length(n);
      p.normal = twice > 0 ? n * (1 / twice) : Vec3{};
      p.area = twice / 2;
      ring_.push_back(p);
      if (!(twice > 0)) continue;
      float w = p.area / 3;
      if (options_.weighting == Weighting::uniform) w = 1;
      if (options_.weighting == Weighting::area_angle) {
        const float cosine = dot(e1, e2) / std::max(length(e1) * length(e2), 1e-30f);
        w = p.area * std::acos(std::clamp(cosine, -1.0f, 1.0f)) / 3.14159265f;
      }
      a.q.add_plane(p.normal, 0, w);
      if (s_.columns) add_slopes(a, p, e1, e2, n, twice);
    }
    if (!closed_fans(a)) constrain_irregular(a);
    const int source = s_.vertex_source[v];
    if (in_.importance) weigh(a, in_.importance[source]);
    if (in_.locked && in_.locked[source]) a.flags |= kLocked;
  }

 private:
  struct Spoke {
    int32_t next, previous, wedge, next_wedge, previous_wedge;
    Vec3 normal;
    float area;
  };

  // Gradient of each attribute over the face (Hoppe 1999, section 3); its offset at the vertex is 0 to begin with.
  void add_slopes(Vertex& a, const Spoke& p, Vec3 e1, Vec3 e2, Vec3 n, float twice) {
    const float w = p.area / 3;
    const float over = 1 / (twice * twice);
    const Vec3 g1 = cross(e2, n) * over, g2 = cross(n, e1) * over;
    const float *v0 = &s_.value[static_cast<size_t>(p.wedge) * s_.columns],
                *v1 = &s_.value[static_cast<size_t>(p.next_wedge) * s_.columns],
                *v2 = &s_.value[static_cast<size_t>(p.previous_wedge) * s_.columns];
    Slope* slope = &s_.slope[static_cast<size_t>(p.wedge) * s_.columns];
    s_.weight[p.wedge] += w;
    for (int k = 0; k < s_.columns; ++k) {
      const Vec3 g = g1 * (v1[k] - v0[k]) + g2 * (v2[k] - v0[k]);
      slope[k].x += w * g.x, slope[k].y += w * g.y, slope[k].z += w * g.z;
      if (k < s_.steering) a.q.add_plane(g, 0, w);
    }
  }

  // Regular: each edge round the vertex leaves one face and enters one other. Then it is held where it is a seam.
  bool closed_fans(Vertex& a) {
    const size_t count = ring_.size();
    if (count > kSmallFan) return false;
    uint8_t match[kSmallFan];
    for (size_t i = 0; i < count; ++i) {
      int found = 0, same = 0;
      for (size_t j = 0; j < count; ++j) {
        const bool hit = ring_[j].previous == ring_[i].next;
        found += hit;
        same += ring_[j].next == ring_[i].next;
        if (hit) match[i] = static_cast<uint8_t>(j);
      }
      if (found != 1 || same != 1) return false;
    }
    for (size_t i = 0; i < count; ++i) {
      const Spoke &p = ring_[i], &q = ring_[match[i]];
      const float weight = discontinuity(p, q, p.next);
      if (!(weight > 0)) continue;
      hold(a, p, p.next, weight);
      hold(a, q, p.next, weight);
    }
    return true;
  }

  void constrain_irregular(Vertex& a) {
    a.flags |= kIrregular;
    edges_.clear();
    for (int i = 0; i < static_cast<int>(ring_.size()); ++i) {
      edges_.push_back({ring_[i].next, i});
      edges_.push_back({ring_[i].previous, i});
    }
    std::sort(edges_.begin(), edges_.end());
    for (size_t i = 0, j; i < edges_.size(); i = j) {
      for (j = i + 1; j < edges_.size() && edges_[j].first == edges_[i].first;) ++j;
      const int32_t other = edges_[i].first;
      float weight = options_.seam_weight;
      if (j - i == 1) weight = options_.boundary_weight;
      if (j - i == 2) weight = discontinuity(ring_[edges_[i].second], ring_[edges_[i + 1].second], other);
      if (weight > 0)
        for (size_t k = i; k < j; ++k) hold(a, ring_[edges_[k].second], other, weight);
    }
  }

  // Weight of the edge to `other`, between the faces of p and q.
  float discontinuity(const Spoke& p, const Spoke& q, int32_t other) const {
    if (p.wedge != q.wedge || wedge_at(p, other) != wedge_at(q, other)) return options_.seam_weight;
    return dot(p.normal, q.normal) < options_.crease_cos ? options_.crease_weight : 0;
  }
  static int32_t wedge_at(const Spoke& p, int32_t vertex) { return p.next == vertex ? p.next_wedge : p.previous_wedge; }

  // A plane through the edge, perpendicular to the face (Garland & Heckbert 1997, section 6).
  void hold(Vertex& a, const Spoke& p, int32_t other, float weight) {
    if (!(p.area > 0)) return;
    const Vec3 e = s_.vertices[other].p - a.p;
    const float size = options_.weighting == Weighting::uniform ? 1.0f : dot(e, e);
    a.q.add_plane(normalized(cross(e, p.normal)), 0, weight * size);
  }

  void weigh(Vertex& a, float importance) {
    a.q *= importance;
    if (!s_.columns) return;
    int32_t last = kNone;
    for (const Spoke& p : ring_) {
      if (p.wedge == last || (last != kNone && seen_before(p))) continue;
      last = p.wedge;
      s_.weight[p.wedge] *= importance;
      for (int k = 0; k < s_.columns; ++k) {
        Slope& t = s_.slope[static_cast<size_t>(p.wedge) * s_.columns + k];
        t.x *= importance, t.y *= importance, t.z *= importance;
      }
    }
  }
  bool seen_before(const Spoke& p) const {
    for (const Spoke& q : ring_) {
      if (&q == &p) return false;
      if (q.wedge == p.wedge) return true;
    }
    return false;
  }

  const Input& in_;
  const Options& options_;
  State& s_;
  std::vector<Spoke> ring_;
  std::vector<std::pair<int32_t, int>> edges_;  // (other end, row of ring_)
};

}  // namespace

void prepare(const Input& in, const Options& options, Pool& pool, State& s) {
  fit_unit_box(in, s);
  place_faces(in, order_all(in, s), s);
  place_wedges(in, options, s);
  if (options.pair_distance > 0) add_links(static_cast<float>(options.pair_distance * s.scale), s);
  link_corners(s);
  pool.range(in.vertex_count, kGrain, [&](int begin, int end) {
    FirstQuadrics first(in, options, s);
    for (int v = begin; v < end; ++v) first(v);
  });
  s.cost.assign(in.vertex_count, kInfinity);
  s.partner.assign(in.vertex_count, kNone);
  s.stamp.assign(in.vertex_count, 0);
  s.live.reserve(in.vertex_count);
  for (int v = 0; v < in.vertex_count; ++v)
    if (s.vertices[v].head != kNone) s.live.push_back(v);
}

}  // namespace lodpipe
