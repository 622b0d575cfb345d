// From the input arrays to the state: order, scale, adjacency, first quadrics.
#include "prepare.h"

#include <cmath>
#include <numeric>

#include "pairs.h"

namespace lodpipe {
namespace {

constexpr int kGrain = 2048;

void fit_unit_box(const Input& in, State& s) {
  double lo[3] = {0, 0, 0}, hi[3] = {0, 0, 0};
  bool any = false;
  for (int64_t f = 0; f < in.face_count; ++f) {  // positions that no face uses do not count
    const int32_t* v = in.faces + 3 * f;
    if (v[0] == v[1] || v[1] == v[2] || v[0] == v[2]) continue;
    for (int i = 0; i < 9; ++i) {
      const double x = in.positions[3 * static_cast<int64_t>(v[i / 3]) + i % 3];
      lo[i % 3] = any || i > 2 ? std::min(lo[i % 3], x) : x;
      hi[i % 3] = any || i > 2 ? std::max(hi[i % 3], x) : x;
    }
    any = true;
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
  s.flags.assign(count, 0);
  s.vertex_source.resize(count);
  for (int i = 0; i < count; ++i) {
    rank[keys[i].id] = i;
    s.vertex_source[i] = keys[i].id;
    s.vertices[i] = Vertex{at[keys[i].id], {}, 0, 0, 0};
  }
  return rank;
}

void place_faces(const Input& in, const std::vector<int32_t>& rank, State& s) {
  std::vector<int32_t> start(static_cast<size_t>(in.vertex_count) + 1, 0);
  const auto first = [&](int64_t f) {
    const int32_t* v = in.faces + 3 * f;
    return std::min(std::min(rank[v[0]], rank[v[1]]), rank[v[2]]);
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
  s.wedges.resize(s.triangles);
  for (int64_t f = 0; f < in.face_count; ++f) {
    if (flat(f)) continue;
    const int32_t* v = in.faces + 3 * f;
    const int32_t* w = in.wedges + 3 * f;
    const int32_t to = start[first(f)]++;
    s.faces[to] = {{rank[v[0]], rank[v[1]], rank[v[2]]}, static_cast<int32_t>(f)};
    s.wedges[to] = {{w[0], w[1], w[2]}};
  }
}

void place_wedges(const Input& in, const Options& options, State& s) {
  std::vector<int32_t> number(in.wedge_count, kNone);
  for (Wedges& f : s.wedges)
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
        if (k == options.chart_column) s.chart_column = static_cast<int>(s.column_source.size());
        s.column_source.push_back(k);
        s.column_scale.push_back(steers ? static_cast<float>(in.column_weights[k] * s.scale) : 1.0f);
      }
    }
    if (pass == 0) s.steering = static_cast<int>(s.column_source.size());
  }
  // u and v are looked at together: both steer, or neither
  const auto v_column = static_cast<size_t>(s.chart_column) + 1;
  if (s.chart_column >= 0 && (v_column >= s.column_source.size() || s.column_source[v_column] != options.chart_column + 1))
    s.chart_column = -1;
  const size_t count = s.wedge_source.size();
  s.late = s.columns && !s.steering && !options.record;
  if (!s.columns || s.late) return;
  s.fitted = s.steering || options.placement != Placement::endpoint;
  s.row = s.fitted ? (static_cast<size_t>(s.columns) * 5 + 1 + 3) / 4 * 4 : s.columns;
  s.rows.assign(count * s.row, 0.0f);
  s.wedge_moved.resize(count);
  for (size_t i = 0; i < count; ++i)
    for (int k = 0; k < s.columns; ++k)
      s.values(static_cast<int32_t>(i))[k] =
          in.values[static_cast<size_t>(s.wedge_source[i]) * s.columns + s.column_source[k]] * s.column_scale[k];
}

// Planes and slopes of the faces, added to their corners. Each quadric has its origin at its own corner, through which
// the plane passes: b and c begin at 0.
class FaceQuadrics {
 public:
  FaceQuadrics(const Options& options, State& s) : options_(options), s_(s) {}

  void operator()(int32_t face) {
    const Face& f = s_.faces[face];
    const Vec3 p[3] = {s_.vertices[f.v[0]].p, s_.vertices[f.v[1]].p, s_.vertices[f.v[2]].p};
    const Vec3 e1 = p[1] - p[0], e2 = p[2] - p[0], across = cross(e1, e2);
    const float twice = length(across);
    if (!(twice > 0)) return;
    const Vec3 n = across * (1 / twice);
    if (options_.weighting == Weighting::area) {
      Quadric plane;
      plane.add_plane(n, twice / 6);
      for (const int32_t v : f.v) {
        Quadric& q = s_.vertices[v].q;
        q.xx += plane.xx, q.xy += plane.xy, q.xz += plane.xz, q.yy += plane.yy, q.yz += plane.yz, q.zz += plane.zz;
      }
    } else {
      for (int k = 0; k < 3; ++k) s_.vertices[f.v[k]].q.add_plane(n, plane_weight(p, k, twice / 2));
    }
    if (s_.fitted) add_slopes(f, s_.wedges[face], cross(e2, n), cross(n, e1), twice);
  }

 private:
  float plane_weight(const Vec3* p, int k, float area) const {
    if (options_.weighting == Weighting::uniform) return 1;
    const Vec3 a = p[(k + 1) % 3] - p[k], b = p[(k + 2) % 3] - p[k];
    const float cosine = dot(a, b) / std::max(length(a) * length(b), 1e-30f);
    return area * std::acos(std::clamp(cosine, -1.0f, 1.0f)) / 3.14159265f;
  }

  // Each attribute is linear over the face (Hoppe 1999, section 3): value₀ + g·x, with g from the two dual edges.
  // A third of the face's area goes to each corner; there the function equals the wedge's value, so its offset is 0.
  void add_slopes(const Face& f, const Wedges& wedges, Vec3 dual1, Vec3 dual2, float twice) {
    const float weight = twice / 6;
    const float *v0 = s_.values(wedges.w[0]), *v1 = s_.values(wedges.w[1]), *v2 = s_.values(wedges.w[2]);
    Slope* slope[3];
    for (int i = 0; i < 3; ++i) {
      slope[i] = s_.slopes(wedges.w[i]);
      s_.weight(wedges.w[i]) += weight;
    }
    const Vec3 half1 = dual1 * (1.0f / 6), half2 = dual2 * (1.0f / 6);
    for (int k = 0; k < s_.columns; ++k) {
      const Vec3 g = half1 * (v1[k] - v0[k]) + half2 * (v2[k] - v0[k]);  // × weight
      const Slope add{g.x, g.y, g.z, 0};
      for (int i = 0; i < 3; ++i) slope[i][k] += add;
      if (k < s_.steering)
        for (int i = 0; i < 3; ++i) s_.vertices[f.v[i]].q.add_plane(g, 1 / weight);
    }
  }

  const Options& options_;
  State& s_;
};

// Blocks of faces side by side; faces between two blocks afterwards. The order of the sums does not depend on threads.
void add_faces(const Options& options, Pool& pool, State& s) {
  constexpr int kBlocks = 16;
  const auto width = static_cast<int32_t>(s.vertices.size() / kBlocks + 1);
  const auto triangles = static_cast<int32_t>(s.triangles);
  // faces are in the order of their first vertex
  std::vector<int32_t> start(kBlocks + 1, triangles);
  for (int b = 0; b <= kBlocks; ++b) {
    const auto first = [](const Face& f) { return std::min({f.v[0], f.v[1], f.v[2]}); };
    start[b] = static_cast<int32_t>(std::partition_point(s.faces.begin(), s.faces.begin() + triangles,
                                                         [&](const Face& f) { return first(f) / width < b; }) -
                                    s.faces.begin());
  }
  std::vector<std::vector<int32_t>> between(kBlocks);
  pool.run(kBlocks, [&](int b) {
    FaceQuadrics add(options, s);
    for (int32_t i = start[b]; i < start[b + 1]; ++i) {
      const Face& f = s.faces[i];
      if (std::max({f.v[0], f.v[1], f.v[2]}) / width == b) add(i);
      else between[b].push_back(i);
    }
  });
  FaceQuadrics add(options, s);
  for (const auto& list : between)
    for (const int32_t i : list) add(i);
}

// What the faces round one vertex tell of it: borders, seams and creases, which get planes of their own; and whether
// they form closed fans.
class Surroundings {
 public:
  Surroundings(const Input& in, const Options& options, State& s) : in_(in), options_(options), s_(s) {}

  void operator()(int v) {
    Vertex& a = s_.vertices[v];
    uint8_t& flags = s_.flags[v];
    const bool inside = all_inside(a);
    if (!inside || s_.fitted) gather(a, flags);
    if (!inside) look_closer(a, flags);
    const int source = s_.vertex_source[v];
    if (in_.importance) weigh(a, in_.importance[source]);
    if (in_.locked && in_.locked[source]) flags |= kLocked;
  }

 private:
  struct Spoke {
    int32_t next, previous, wedge, next_wedge, previous_wedge;
    int32_t source, slot;  // face of the input, and which of its corners
  };

  // Whether it is certain that nothing is to be found here: the same edges enter and leave, with the same wedges (sums of
  // hashes tell), no neighbour comes next twice, and all corners have one wedge.
  bool all_inside(const Vertex& a) const {
    if (options_.crease_weight > 0 || s_.has_links) return false;
    const Face* const faces = s_.faces.data();
    const Wedges* const wedges = s_.wedges.data();
    const int32_t *at = s_.corners.begin(a), *const end = s_.corners.end(a);
    if (at == end) return true;
    const int32_t wedge = wedges[face_of(*at)].w[slot_of(*at)];
    uint64_t entering = 0, leaving = 0, seen = 0;
    bool twice = false, one = true;
    for (; at != end; ++at) {
      const int32_t* v = faces[face_of(*at)].v;
      const int32_t* w = wedges[face_of(*at)].w;
      const int k = slot_of(*at), i = kNext[k], j = kNext[i];
      const uint64_t out = mix(v[i], w[i]), bit = uint64_t{1} << (out >> 58);
      one &= w[k] == wedge;
      leaving += out;
      entering += mix(v[j], w[j]);
      twice |= (seen & bit) != 0;
      seen |= bit;
    }
    return one && entering == leaving && (!twice || !repeated(a));
  }

  // Whether a neighbour comes next twice.
  bool repeated(const Vertex& a) const {
    const auto next = [&](const int32_t* c) { return s_.faces[face_of(*c)].v[kNext[slot_of(*c)]]; };
    if (a.count > 32) return true;
    for (const int32_t* c = s_.corners.begin(a); c != s_.corners.end(a); ++c)
      for (const int32_t* d = s_.corners.begin(a); d != c; ++d)
        if (next(c) == next(d)) return true;
    return false;
  }

  void gather(const Vertex& a, uint8_t& flags) {
    ring_.clear();
    for (const int32_t* at = s_.corners.begin(a); at != s_.corners.end(a); ++at) {
      const int32_t c = *at;
      const Face& f = s_.faces[face_of(c)];
      if (f.link()) {
        flags |= kIrregular;
        continue;
      }
      const int32_t* w = s_.wedges[face_of(c)].w;
      const int k = slot_of(c), i = kNext[k], j = kNext[i];
      ring_.push_back({f.v[i], f.v[j], w[k], w[i], w[j], f.source, k});
      if (w[k] != ring_[0].wedge) flags |= kSeveralWedges;
    }
  }

  static uint64_t mix(int32_t v, int32_t w) {
    uint64_t x = (static_cast<uint64_t>(v) << 32 | static_cast<uint32_t>(w)) * 0x9E3779B97F4A7C15u;
    return (x ^ x >> 29) * 0xBF58476D1CE4E5B9u;
  }

  void look_closer(Vertex& a, uint8_t& flags) {
    edges_.clear();
    for (int i = 0; i < static_cast<int>(ring_.size()); ++i) {
      edges_.push_back({ring_[i].next, i});
      edges_.push_back({ring_[i].previous, i});
    }
    std::sort(edges_.begin(), edges_.end());
    for (size_t i = 0, j; i < edges_.size(); i = j) {
      for (j = i + 1; j < edges_.size() && edges_[j].first == edges_[i].first;) ++j;
      const int32_t other = edges_[i].first;
      float weight = seam_weight(ring_[edges_[i].second], other);
      if (j - i == 1) weight = options_.boundary_weight;
      if (j - i == 2) {
        const Spoke &p = ring_[edges_[i].second], &q = ring_[edges_[i + 1].second];
        weight = discontinuity(a, p, q, other);
        if ((p.next == other) == (q.next == other)) flags |= kIrregular;
      } else {
        flags |= kIrregular;
      }
      if (weight > 0)
        for (size_t k = i; k < j; ++k) hold(a, ring_[edges_[k].second], other, weight);
    }
  }

  // Weight of the edge to `other`, between the faces of p and q.
  float discontinuity(const Vertex& a, const Spoke& p, const Spoke& q, int32_t other) const {
    if (p.wedge != q.wedge || wedge_at(p, other) != wedge_at(q, other)) return seam_weight(p, other);
    if (!(options_.crease_weight > 0)) return 0;
    return dot(normalized(normal(a, p)), normalized(normal(a, q))) < options_.crease_cos ? options_.crease_weight : 0;
  }
  float seam_weight(const Spoke& p, int32_t other) const {
    if (!in_.seam_scale) return options_.seam_weight;
    const int edge = p.next == other ? p.slot : (p.slot + 2) % 3;
    return options_.seam_weight * in_.seam_scale[3 * static_cast<int64_t>(p.source) + edge];
  }
  static int32_t wedge_at(const Spoke& p, int32_t vertex) { return p.next == vertex ? p.next_wedge : p.previous_wedge; }
  Vec3 normal(const Vertex& a, const Spoke& p) const {
    return cross(s_.vertices[p.next].p - a.p, s_.vertices[p.previous].p - a.p);
  }

  // A plane through the edge, perpendicular to the face (Garland & Heckbert 1997, section 6).
  void hold(Vertex& a, const Spoke& p, int32_t other, float weight) {
    const Vec3 e = s_.vertices[other].p - a.p;
    const float size = options_.weighting == Weighting::uniform ? 1.0f : dot(e, e);
    a.q.add_plane(normalized(cross(e, normal(a, p))), weight * size);
  }

  void weigh(Vertex& a, float importance) {
    a.q *= importance;
    if (!s_.fitted) return;
    for (size_t i = 0; i < ring_.size(); ++i) {
      const int32_t wedge = ring_[i].wedge;
      const auto same = [wedge](const Spoke& q) { return q.wedge == wedge; };
      if (std::any_of(ring_.begin(), ring_.begin() + i, same)) continue;
      s_.weight(wedge) *= importance;
      for (int k = 0; k < s_.columns; ++k) {
        Slope& t = s_.slopes(wedge)[k];
        t.x *= importance, t.y *= importance, t.z *= importance;
      }
    }
  }

  const Input& in_;
  const Options& options_;
  State& s_;
  Buffer<Spoke> ring_;
  std::vector<std::pair<int32_t, int>> edges_;  // (other end, row of ring_)
};

}  // namespace

void list_corners(State& s) {
  const auto corners = [](const Face& f) { return f.link() ? 2 : 3; };
  std::vector<int32_t> counts(s.vertices.size(), 0);
  int32_t* const next = counts.data();
  for (const Face& f : s.faces)
    for (int k = 0; k < corners(f); ++k) ++next[f.v[k]];
  int32_t filled = 0;
  for (const int32_t v : s.live) {
    s.vertices[v].first = filled, s.vertices[v].count = next[v];
    next[v] = filled;
    filled += s.vertices[v].count;
  }
  s.corners.start(filled);
  int32_t* const items = s.corners.items();
  const Face* const faces = s.faces.data();
  const auto count = static_cast<int32_t>(s.faces.size());
  for (int32_t i = 0; i < count; ++i)
    for (int k = 0; k < corners(faces[i]); ++k) items[next[faces[i].v[k]]++] = corner(i, k);
}

void prepare(const Input& in, const Options& options, Pool& pool, State& s) {
  fit_unit_box(in, s);
  place_faces(in, order_all(in, s), s);
  place_wedges(in, options, s);
  if (options.pair_distance > 0) add_links(static_cast<float>(options.pair_distance * s.scale), s);
  s.has_links = static_cast<int64_t>(s.faces.size()) > s.triangles;
  s.live.resize(in.vertex_count);
  std::iota(s.live.begin(), s.live.end(), 0);
  list_corners(s);
  add_faces(options, pool, s);
  pool.range(in.vertex_count, kGrain, [&](int begin, int end) {
    Surroundings look(in, options, s);
    for (int v = begin; v < end; ++v) look(v);
  });
  s.candidates.assign(in.vertex_count, {kInfinity, kNone, 0, kDirty});
  s.live.erase(std::remove_if(s.live.begin(), s.live.end(), [&](int32_t v) { return !s.vertices[v].count; }),
               s.live.end());
}

}  // namespace lodpipe
