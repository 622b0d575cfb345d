// Samples of the original are carried to the level through the wedges that collapsed into one another, from there to the
// nearest face by walking within the chart. What the level shows at a sample is linear in its vertices' positions and
// values: two sparse least-squares systems, solved by conjugate gradients.
#include "fit.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "parallel.h"
#include "quadric.h"

namespace lodpipe {
namespace {

constexpr int kGrain = 4096;
constexpr int kHops = 8;             // from face to nearer face
constexpr int kSteps = 24;           // of conjugate gradients
constexpr double kEnough = 1e-8;     // squared residual, relative
constexpr float kPrior = 0.02f;      // what the level says of itself counts like so large a share of the samples
constexpr float kTangential = 0.05f;  // a sample holds its place along the surface so much less than across it
constexpr float kGutter = 4.0f / 1024;  // UV units beyond a chart's border that textures are expected to be padded by
constexpr float kExact = 1e-4f;      // root mean square misfit of a value below which nothing is to be gained
constexpr float kNear = 2e-6f;       // the same of a vertex, in diagonals
constexpr int32_t kNone = -1;

struct Hit {
  int32_t face = kNone;     // of the level
  float b1 = 0, b2 = 0;     // barycentric there
  float distance2 = 0;      // squared, to there
  int32_t source = kNone;   // face of the original
  float a1 = 0, a2 = 0;
};

struct Place {
  float b1, b2, distance2;
};

// Closest point of a triangle (Ericson 2004, section 5.1.5).
Place closest(Vec3 p, Vec3 a, Vec3 b, Vec3 c) {
  const Vec3 ab = b - a, ac = c - a, ap = p - a;
  const auto at = [&](float s, float t) {
    const Vec3 d = ap - ab * s - ac * t;
    return Place{s, t, dot(d, d)};
  };
  const float d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return at(0, 0);
  const Vec3 bp = p - b;
  const float d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return at(1, 0);
  const float vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return at(d1 / (d1 - d3), 0);
  const Vec3 cp = p - c;
  const float d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return at(0, 1);
  const float vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return at(0, d2 / (d2 - d6));
  const float va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    const float w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    return at(1 - w, w);
  }
  const float sum = va + vb + vc;
  if (!(sum > 0)) return at(0, 0);
  return at(vb / sum, vc / sum);
}

class Fit {
 public:
  Fit(const FitInput& in, const FitOptions& options, const std::function<bool()>& go_on)
      : in_(in), options_(options), go_on_(go_on), pool_(std::max(options.threads, 1)) {
    load();
    spread();
  }

  FitResult run() {
    FitResult out;
    out.moved.assign(in_.level.vertex_count, 0);
    values_.assign(in_.level.values, in_.level.values + static_cast<size_t>(in_.level.wedge_count) * in_.columns);
    carry();
    for (int i = 0; i < options_.moves && go_on_(); ++i) move_where_it_pays();
    if (options_.fit_values && in_.columns && go_on_()) fit_values();
    out.positions.assign(in_.level.positions, in_.level.positions + 3 * static_cast<size_t>(in_.level.vertex_count));
    for (int v = 0; v < in_.level.vertex_count; ++v) {
      const Vec3 d = at_[v] - start_[v];
      if (d.x == 0 && d.y == 0 && d.z == 0) continue;
      out.moved[v] = 1;
      out.positions[3 * static_cast<size_t>(v)] += d.x / scale_;
      out.positions[3 * static_cast<size_t>(v) + 1] += d.y / scale_;
      out.positions[3 * static_cast<size_t>(v) + 2] += d.z / scale_;
    }
    out.values = std::move(values_);
    return out;
  }

 private:
  Vec3 scaled(const double* p) const {
    return {static_cast<float>((p[0] - center_[0]) * scale_), static_cast<float>((p[1] - center_[1]) * scale_),
            static_cast<float>((p[2] - center_[2]) * scale_)};
  }

  // Both meshes in a box of unit diagonal; the faces round each wedge and each vertex of the level.
  void load() {
    double lo[3] = {0, 0, 0}, hi[3] = {0, 0, 0};
    for (int64_t i = 0; i < 3 * static_cast<int64_t>(in_.original.face_count); ++i) {
      const double* p = in_.original.positions + 3 * static_cast<int64_t>(in_.original.faces[i]);
      for (int k = 0; k < 3; ++k) lo[k] = i ? std::min(lo[k], p[k]) : p[k], hi[k] = i ? std::max(hi[k], p[k]) : p[k];
    }
    const double half = std::hypot(hi[0] / 2 - lo[0] / 2, hi[1] / 2 - lo[1] / 2, hi[2] / 2 - lo[2] / 2);
    for (int k = 0; k < 3; ++k) center_[k] = lo[k] / 2 + hi[k] / 2;
    scale_ = half > 0 ? 0.5 / half : 1;
    source_.resize(in_.original.vertex_count);
    for (int v = 0; v < in_.original.vertex_count; ++v) source_[v] = scaled(in_.original.positions + 3 * static_cast<int64_t>(v));
    at_.resize(in_.level.vertex_count);
    for (int v = 0; v < in_.level.vertex_count; ++v) at_[v] = scaled(in_.level.positions + 3 * static_cast<int64_t>(v));
    start_ = at_;
    index(in_.level.wedges, in_.level.wedge_count, wedge_start_, wedge_faces_);
    index(in_.level.faces, in_.level.vertex_count, vertex_start_, vertex_faces_);
  }

  // The corners of the level (3 · face + slot) that have each of `count` numbers.
  void index_corners(const int32_t* numbers, int count, std::vector<int32_t>& start, std::vector<int32_t>& corners) const {
    const int64_t all = 3 * static_cast<int64_t>(in_.level.face_count);
    start.assign(static_cast<size_t>(count) + 1, 0);
    for (int64_t i = 0; i < all; ++i) ++start[numbers[i] + 1];
    for (int i = 0; i < count; ++i) start[i + 1] += start[i];
    corners.resize(all);
    std::vector<int32_t> next(start.begin(), start.end() - 1);
    for (int64_t i = 0; i < all; ++i) corners[next[numbers[i]]++] = static_cast<int32_t>(i);
  }
  void index(const int32_t* numbers, int count, std::vector<int32_t>& start, std::vector<int32_t>& faces) const {
    index_corners(numbers, count, start, faces);
    for (int32_t& c : faces) c /= 3;
  }

  // Equal shares of the area, each with one sample at a place of its own (the R2 sequence).
  void spread() {
    const int count = in_.original.face_count;
    std::vector<double> sum(static_cast<size_t>(count) + 1, 0);
    for (int f = 0; f < count; ++f) {
      const int32_t* v = in_.original.faces + 3 * static_cast<int64_t>(f);
      const float* w = in_.importance;
      const float area = length(cross(source_[v[1]] - source_[v[0]], source_[v[2]] - source_[v[0]])) / 2;
      sum[f + 1] = sum[f] + (w ? area * (w[v[0]] + w[v[1]] + w[v[2]]) / 3 : area);
    }
    if (!(sum[count] > 0) || options_.samples < 1) return;
    hits_.resize(options_.samples);
    share_ = static_cast<float>(sum[count] / options_.samples);
    int32_t f = 0;
    for (int i = 0; i < options_.samples; ++i) {
      const double wanted = (i + 0.5) * sum[count] / options_.samples;
      while (f + 1 < count && sum[f + 1] <= wanted) ++f;
      double r = std::fmod(0.5 + 0.7548776662466927 * i, 1.0), s = std::fmod(0.5 + 0.5698402909980532 * i, 1.0);
      if (r + s > 1) r = 1 - r, s = 1 - s;
      hits_[i].source = f;
      hits_[i].a1 = static_cast<float>(r), hits_[i].a2 = static_cast<float>(s);
    }
  }

  Vec3 normal_of_level(int32_t f) const {
    const int32_t* v = in_.level.faces + 3 * static_cast<int64_t>(f);
    return cross(at_[v[1]] - at_[v[0]], at_[v[2]] - at_[v[0]]);
  }

  // Each sample to the nearest face of its chart.
  void carry() {
    pool_.range(static_cast<int>(hits_.size()), kGrain, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) carry(hits_[i]);
    });
  }

  void carry(Hit& hit) const {
    const int32_t* v = in_.original.faces + 3 * static_cast<int64_t>(hit.source);
    const int32_t* w = in_.original.wedges + 3 * static_cast<int64_t>(hit.source);
    const Vec3 a = source_[v[0]], b = source_[v[1]], c = source_[v[2]];
    const Vec3 p = a + (b - a) * hit.a1 + (c - a) * hit.a2, n = cross(b - a, c - a);
    float best = kInfinity;
    const auto look = [&](int32_t wedge) {
      bool nearer = false;
      for (int32_t i = wedge_start_[wedge]; i < wedge_start_[wedge + 1]; ++i) {
        const int32_t f = wedge_faces_[i];
        const int32_t* u = in_.level.faces + 3 * static_cast<int64_t>(f);
        const Place q = closest(p, at_[u[0]], at_[u[1]], at_[u[2]]);
        if (q.distance2 < best && dot(normal_of_level(f), n) > 0) {
          best = q.distance2, nearer = true;
          hit.face = f, hit.b1 = q.b1, hit.b2 = q.b2, hit.distance2 = q.distance2;
        }
      }
      return nearer;
    };
    const int32_t before = hit.face;
    hit.face = kNone;
    if (before != kNone) {
      for (int k = 0; k < 3; ++k) look(in_.level.wedges[3 * static_cast<int64_t>(before) + k]);
    } else {
      for (int k = 0; k < 3; ++k)
        if (const int32_t to = in_.wedge_to[w[k]]; to != kNone && (k < 1 || to != in_.wedge_to[w[k - 1]])) look(to);
    }
    for (int hop = 0; hop < kHops && hit.face != kNone; ++hop) {
      const int32_t from = hit.face;
      // towards the corners that the closest point lies near
      const float weight[3] = {1 - hit.b1 - hit.b2, hit.b1, hit.b2};
      if (weight[0] > 0.001f && weight[1] > 0.001f && weight[2] > 0.001f) return;
      for (int k = 0; k < 3; ++k)
        if (weight[k] > 0.001f) look(in_.level.wedges[3 * static_cast<int64_t>(from) + k]);
      if (hit.face == from) return;
    }
  }

  // ---------------------------------------------------------------- positions

  struct FaceSystem {
    std::array<std::array<float, 6>, 6> a{};  // of the corners 00 01 02 11 12 22: xx xy xz yy yz zz
    Vec3 r[3];
  };

  static Vec3 times(const std::array<float, 6>& a, Vec3 v) {
    return {a[0] * v.x + a[1] * v.y + a[2] * v.z, a[1] * v.x + a[3] * v.y + a[4] * v.z, a[2] * v.x + a[4] * v.y + a[5] * v.z};
  }
  static constexpr int kPair[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};

  // A vertex goes back if the samples round it came no nearer, or had been on the surface before.
  void move_where_it_pays() {
    const std::vector<Vec3> before = at_;
    const std::vector<Hit> hits = hits_;
    move();
    carry();
    std::vector<double> was(at_.size(), 0), is(at_.size(), 0), count(at_.size(), 0);
    for (size_t i = 0; i < hits_.size(); ++i) {
      if (hits[i].face == kNone || hits_[i].face == kNone) continue;
      for (int k = 0; k < 3; ++k) {
        const int32_t v = in_.level.faces[3 * static_cast<int64_t>(hits[i].face) + k];
        was[v] += hits[i].distance2, is[v] += hits_[i].distance2, ++count[v];
      }
    }
    bool any = false;
    for (size_t v = 0; v < at_.size(); ++v) {
      if (is[v] < was[v] && was[v] > kNear * kNear * count[v]) continue;
      at_[v] = before[v];
      any = true;
    }
    if (any) carry();
  }

  // min Σ w ‖x − Σ b (p + d)‖² in the metric n nᵀ + kTangential I, over the vertices' steps d.
  void move() {
    const int faces = in_.level.face_count, vertices = in_.level.vertex_count;
    std::vector<FaceSystem> systems(faces);
    for (const Hit& hit : hits_) {
      if (hit.face == kNone) continue;
      FaceSystem& s = systems[hit.face];
      const int32_t* v = in_.original.faces + 3 * static_cast<int64_t>(hit.source);
      const int32_t* u = in_.level.faces + 3 * static_cast<int64_t>(hit.face);
      const Vec3 a = source_[v[0]], b = source_[v[1]], c = source_[v[2]];
      const Vec3 n = normalized(cross(b - a, c - a));
      const float weight[3] = {1 - hit.b1 - hit.b2, hit.b1, hit.b2};
      const Vec3 off = a + (b - a) * hit.a1 + (c - a) * hit.a2 -
                       (at_[u[0]] * weight[0] + at_[u[1]] * weight[1] + at_[u[2]] * weight[2]);
      const std::array<float, 6> metric = {n.x * n.x + kTangential, n.x * n.y, n.x * n.z, n.y * n.y + kTangential, n.y * n.z,
                                           n.z * n.z + kTangential};
      const Vec3 pull = times(metric, off) * share_;
      for (int k = 0, pair = 0; k < 3; ++k) {
        s.r[k] = s.r[k] + pull * weight[k];
        for (int l = k; l < 3; ++l, ++pair)
          for (int i = 0; i < 6; ++i) s.a[pair][i] += share_ * weight[k] * weight[l] * metric[i];
      }
    }
    for (int f = 0; f < faces; ++f) {
      const float mass = kPrior * length(normal_of_level(f)) / 24;
      for (int pair = 0; pair < 6; ++pair) {
        const float m = pair == 0 || pair == 3 || pair == 5 ? 2 * mass : mass;
        systems[f].a[pair][0] += m, systems[f].a[pair][3] += m, systems[f].a[pair][5] += m;
      }
    }
    std::vector<std::array<float, 6>> inverse(vertices);
    std::vector<Vec3> r(vertices), d(vertices), z(vertices), p(vertices), q(vertices);
    for (int v = 0; v < vertices; ++v) {
      std::array<float, 6> a{};
      for (int32_t i = vertex_start_[v]; i < vertex_start_[v + 1]; ++i) {
        const int32_t f = vertex_faces_[i];
        const int k = slot(f, v);
        r[v] = r[v] + systems[f].r[k];
        for (int j = 0; j < 6; ++j) a[j] += systems[f].a[kPair[k][k]][j];
      }
      inverse[v] = inverted(a);
    }
    const auto multiply = [&] {
      pool_.range(vertices, kGrain, [&](int begin, int end) {
        for (int v = begin; v < end; ++v) {
          Vec3 sum;
          for (int32_t i = vertex_start_[v]; i < vertex_start_[v + 1]; ++i) {
            const int32_t f = vertex_faces_[i];
            const int32_t* u = in_.level.faces + 3 * static_cast<int64_t>(f);
            const int k = slot(f, v);
            for (int l = 0; l < 3; ++l) sum = sum + times(systems[f].a[kPair[k][l]], p[u[l]]);
          }
          q[v] = sum;
        }
      });
    };
    const auto product = [](const std::vector<Vec3>& a, const std::vector<Vec3>& b) {
      double sum = 0;
      for (size_t i = 0; i < a.size(); ++i) sum += static_cast<double>(dot(a[i], b[i]));
      return sum;
    };
    const auto precondition = [&] {
      for (int v = 0; v < vertices; ++v) z[v] = times(inverse[v], r[v]);
    };
    precondition();
    p = z;
    double rz = product(r, z);
    const double enough = kEnough * rz;
    for (int step = 0; step < kSteps && rz > enough; ++step) {
      multiply();
      const double curve = product(p, q);
      if (!(curve > 0)) break;
      const auto alpha = static_cast<float>(rz / curve);
      for (int v = 0; v < vertices; ++v) d[v] = d[v] + p[v] * alpha, r[v] = r[v] - q[v] * alpha;
      precondition();
      const double next = product(r, z);
      const auto beta = static_cast<float>(next / rz);
      for (int v = 0; v < vertices; ++v) p[v] = z[v] + p[v] * beta;
      rz = next;
    }
    step(d);
  }

  // Moves all vertices, except where a face would turn over or become a sliver.
  void step(const std::vector<Vec3>& d) {
    const std::vector<Vec3> before = at_;
    std::vector<uint8_t> back(at_.size(), 0);
    for (size_t v = 0; v < at_.size(); ++v) {
      const Vec3 to = at_[v] + d[v];
      if (std::isfinite(to.x) && std::isfinite(to.y) && std::isfinite(to.z)) at_[v] = to;
    }
    for (bool again = true; again;) {
      again = false;
      for (int32_t f = 0; f < in_.level.face_count; ++f) {
        const int32_t* v = in_.level.faces + 3 * static_cast<int64_t>(f);
        if (back[v[0]] && back[v[1]] && back[v[2]]) continue;
        const Vec3 was = cross(before[v[1]] - before[v[0]], before[v[2]] - before[v[0]]), is = normal_of_level(f);
        const float a = dot(was, was), b = dot(is, is), c = dot(was, is);
        if (c > 0 && c * c >= options_.flip_cos * options_.flip_cos * a * b && b > 0.04f * a) continue;
        if (!(a > 0)) continue;
        for (int k = 0; k < 3; ++k)
          if (!back[v[k]]) back[v[k]] = 1, at_[v[k]] = before[v[k]], again = true;
      }
    }
  }

  int slot(int32_t face, int32_t vertex) const {
    const int32_t* v = in_.level.faces + 3 * static_cast<int64_t>(face);
    return v[0] == vertex ? 0 : v[1] == vertex ? 1 : 2;
  }

  static std::array<float, 6> inverted(const std::array<float, 6>& a) {
    const float cxx = a[3] * a[5] - a[4] * a[4], cxy = a[2] * a[4] - a[1] * a[5], cxz = a[1] * a[4] - a[2] * a[3];
    const float det = a[0] * cxx + a[1] * cxy + a[2] * cxz;
    const float trace = a[0] + a[3] + a[5];
    if (!(det > 1e-9f * trace * trace * trace)) {
      const float s = trace > 0 ? 3 / trace : 0;
      return {s, 0, 0, s, 0, s};
    }
    const float over = 1 / det;
    return {cxx * over, cxy * over, cxz * over, (a[0] * a[5] - a[2] * a[2]) * over, (a[1] * a[2] - a[0] * a[4]) * over,
            (a[0] * a[3] - a[1] * a[1]) * over};
  }

  // ---------------------------------------------------------------- values

  // min Σ w (value at the sample − Σ b value of the wedge)², each column for itself.
  void fit_values() {
    const std::vector<float> before = values_;
    const std::vector<float> off = misfit();
    solve();
    if (options_.chart_column >= 0) keep_in_charts();
    const std::vector<float> now = misfit();
    for (size_t i = 0; i < values_.size(); ++i)
      if (!(now[i] < off[i]) || off[i] < kExact * kExact * share_) values_[i] = before[i];
  }

  // Σ w (value at the sample − Σ b value)² over the samples round each wedge, by columns.
  std::vector<float> misfit() {
    std::vector<float> sum(values_.size(), 0.0f);
    for (const Hit& hit : hits_) {
      if (hit.face == kNone) continue;
      const int32_t* w = in_.original.wedges + 3 * static_cast<int64_t>(hit.source);
      const int32_t* u = in_.level.wedges + 3 * static_cast<int64_t>(hit.face);
      const float b[3] = {1 - hit.b1 - hit.b2, hit.b1, hit.b2}, a[3] = {1 - hit.a1 - hit.a2, hit.a1, hit.a2};
      for (int c = 0; c < in_.columns; ++c) {
        float off = 0;
        for (int k = 0; k < 3; ++k) off += a[k] * original_value(w[k], c) - b[k] * value(u[k], c);
        for (int k = 0; k < 3; ++k) sum[static_cast<size_t>(u[k]) * in_.columns + c] += share_ * off * off;
      }
    }
    return sum;
  }

  float& value(int32_t wedge, int column) { return values_[static_cast<size_t>(wedge) * in_.columns + column]; }
  float original_value(int32_t wedge, int column) const {
    return in_.original.values[static_cast<size_t>(wedge) * in_.columns + column];
  }

  // At the border of a chart a fit may reach beyond it, where the texture shows something else: no farther from what
  // the samples round the wedge show than a gutter.
  void keep_in_charts() {
    struct Box {
      float low[2], high[2];
    };
    const int u = options_.chart_column;
    std::vector<Box> boxes(in_.level.wedge_count);
    const auto grow = [](Box& box, const float* at) {
      for (int k = 0; k < 2; ++k) box.low[k] = std::min(box.low[k], at[k]), box.high[k] = std::max(box.high[k], at[k]);
    };
    for (int w = 0; w < in_.level.wedge_count; ++w) {
      const float* at = in_.level.values + static_cast<size_t>(w) * in_.columns + u;
      boxes[w] = {{at[0], at[1]}, {at[0], at[1]}};
    }
    for (const Hit& hit : hits_) {
      if (hit.face == kNone) continue;
      const int32_t* w = in_.original.wedges + 3 * static_cast<int64_t>(hit.source);
      float at[2];
      for (int k = 0; k < 2; ++k)
        at[k] = (1 - hit.a1 - hit.a2) * original_value(w[0], u + k) + hit.a1 * original_value(w[1], u + k) +
                hit.a2 * original_value(w[2], u + k);
      for (int k = 0; k < 3; ++k) grow(boxes[in_.level.wedges[3 * static_cast<int64_t>(hit.face) + k]], at);
    }
    for (int w = 0; w < in_.level.wedge_count; ++w) {
      if (!at_border(w)) continue;
      for (int k = 0; k < 2; ++k) {
        float& x = value(w, u + k);
        x = std::clamp(x, boxes[w].low[k] - kGutter, boxes[w].high[k] + kGutter);
      }
    }
  }

  // Whether the faces that have the wedge leave a gap: then other wedges leave by an edge than enter by one.
  bool at_border(int32_t w) const {
    uint64_t balance = 0;
    const auto mix = [](int32_t x) { return static_cast<uint64_t>(x + 1) * 0x9E3779B97F4A7C15u; };
    for (int32_t i = wedge_start_[w]; i < wedge_start_[w + 1]; ++i) {
      const int32_t* of = in_.level.wedges + 3 * static_cast<int64_t>(wedge_faces_[i]);
      const int k = of[0] == w ? 0 : of[1] == w ? 1 : 2;
      balance += mix(of[(k + 1) % 3]) - mix(of[(k + 2) % 3]);
    }
    return balance != 0;
  }

  // Adds to the wedges' values what fits the samples best.
  void solve() {
    const int width = in_.columns, faces = in_.level.face_count, count = in_.level.wedge_count;
    std::vector<std::array<float, 6>> mass(faces);
    std::vector<float> right(static_cast<size_t>(faces) * 3 * width, 0.0f);
    for (const Hit& hit : hits_) {
      if (hit.face == kNone) continue;
      const int32_t* w = in_.original.wedges + 3 * static_cast<int64_t>(hit.source);
      const int32_t* u = in_.level.wedges + 3 * static_cast<int64_t>(hit.face);
      const float b[3] = {1 - hit.b1 - hit.b2, hit.b1, hit.b2}, a[3] = {1 - hit.a1 - hit.a2, hit.a1, hit.a2};
      for (int k = 0, pair = 0; k < 3; ++k)
        for (int l = k; l < 3; ++l, ++pair) mass[hit.face][pair] += share_ * b[k] * b[l];
      float* to = &right[static_cast<size_t>(hit.face) * 3 * width];
      for (int c = 0; c < width; ++c) {
        float off = 0;
        for (int k = 0; k < 3; ++k) off += a[k] * original_value(w[k], c) - b[k] * value(u[k], c);
        for (int k = 0; k < 3; ++k) to[k * width + c] += share_ * b[k] * off;
      }
    }
    for (int f = 0; f < faces; ++f) {
      const float m = kPrior * length(normal_of_level(f)) / 24;
      for (int pair = 0; pair < 6; ++pair) mass[f][pair] += pair == 0 || pair == 3 || pair == 5 ? 2 * m : m;
    }
    std::vector<int32_t> start_of, corners_of;  // the corners of each unknown: 3 · face + slot
    index_corners(in_.level.wedges, count, start_of, corners_of);
    const size_t size = static_cast<size_t>(count) * width;
    std::vector<float> r(size, 0), x(size, 0), p(size), q(size), over(count, 0);
    for (int i = 0; i < count; ++i) {
      float diagonal = 0;
      for (int32_t j = start_of[i]; j < start_of[i + 1]; ++j) {
        const int32_t f = corners_of[j] / 3;
        const int k = corners_of[j] % 3;
        diagonal += mass[f][kPair[k][k]];
        for (int c = 0; c < width; ++c)
          r[static_cast<size_t>(i) * width + c] += right[(static_cast<size_t>(f) * 3 + k) * width + c];
      }
      over[i] = diagonal > 0 ? 1 / diagonal : 0;
    }
    const auto each = [&](const auto& body) {
      for (int i = 0; i < count; ++i)
        for (int c = 0; c < width; ++c) body(static_cast<size_t>(i) * width + c, c, over[i]);
    };
    std::vector<double> rz(width, 0), start, curve(width), next(width);
    each([&](size_t i, int c, float d) { p[i] = r[i] * d, rz[c] += static_cast<double>(r[i]) * p[i]; });
    start = rz;
    for (int step = 0; step < kSteps; ++step) {
      pool_.range(count, kGrain, [&](int begin, int end) {
        for (int i = begin; i < end; ++i) {
          float* to = &q[static_cast<size_t>(i) * width];
          std::fill(to, to + width, 0.0f);
          for (int32_t j = start_of[i]; j < start_of[i + 1]; ++j) {
            const int32_t f = corners_of[j] / 3;
            const int k = corners_of[j] % 3;
            for (int l = 0; l < 3; ++l) {
              const float m = mass[f][kPair[k][l]];
              const float* from = &p[static_cast<size_t>(in_.level.wedges[3 * static_cast<size_t>(f) + l]) * width];
              for (int c = 0; c < width; ++c) to[c] += m * from[c];
            }
          }
        }
      });
      std::fill(curve.begin(), curve.end(), 0.0), std::fill(next.begin(), next.end(), 0.0);
      each([&](size_t i, int c, float) { curve[c] += static_cast<double>(p[i]) * q[i]; });
      bool any = false;
      for (int c = 0; c < width; ++c) {
        const bool goes_on = rz[c] > kEnough * start[c] && curve[c] > 0;
        curve[c] = goes_on ? rz[c] / curve[c] : 0;
        any |= goes_on;
      }
      if (!any) break;
      each([&](size_t i, int c, float d) {
        const auto alpha = static_cast<float>(curve[c]);
        x[i] += alpha * p[i], r[i] -= alpha * q[i];
        next[c] += static_cast<double>(r[i]) * r[i] * d;
      });
      each([&](size_t i, int c, float d) {
        if (curve[c] > 0) p[i] = r[i] * d + static_cast<float>(next[c] / rz[c]) * p[i];
      });
      rz = next;
    }
    for (size_t i = 0; i < size; ++i)
      if (std::isfinite(values_[i] + x[i])) values_[i] += x[i];
  }

  const FitInput& in_;
  const FitOptions& options_;
  const std::function<bool()>& go_on_;
  Pool pool_;
  double center_[3] = {0, 0, 0}, scale_ = 1;
  std::vector<Vec3> source_, at_, start_;  // vertices of the original, of the level, of the level at first
  std::vector<int32_t> wedge_start_, wedge_faces_, vertex_start_, vertex_faces_;
  std::vector<Hit> hits_;
  float share_ = 0;  // area for each sample
  std::vector<float> values_;
};

}  // namespace

FitResult fit(const FitInput& input, const FitOptions& options, const std::function<bool()>& go_on) {
  return Fit(input, options, go_on).run();
}

}  // namespace lodpipe
