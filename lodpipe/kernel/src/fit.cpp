// Samples of the original are carried to the level through the wedges that collapsed into one another, from there to the
// nearest face by walking within the chart. What the level shows at a sample is linear in its vertices' positions and
// values: two sparse least-squares systems, solved by conjugate gradients. Samples are kept in the order of the level's
// faces: each face adds up its own, in parallel, and nothing depends on the number of threads.
#include "fit.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "fit_samples.h"
#include "least_squares.h"

namespace lodpipe {
namespace {

constexpr int kGrain = 2048;
constexpr Stop kStop = {24, 1e-8};
constexpr float kPrior = 0.02f;      // what the level says of itself counts like so large a share of the samples
constexpr float kTangential = 0.05f;  // a sample holds its place along the surface so much less than across it
constexpr float kGutter = 4.0f / 1024;  // UV units beyond a chart's border that textures are expected to be padded by
constexpr float kExact = 1e-4f;      // root mean square misfit of a value below which nothing is to be gained
constexpr float kNear = 2e-6f;       // the same of a vertex, in diagonals

class Fit {
 public:
  Fit(const FitInput& in, const FitOptions& options, const std::function<bool()>& go_on)
      : in_(in), options_(options), go_on_(go_on), pool_(std::max(options.threads, 1)), target_(in.level, pool_),
        vertices_(in.level.faces, in.level.face_count, in.level.vertex_count) {
    load();
  }

  FitResult run() {
    FitResult out;
    out.moved.assign(in_.level.vertex_count, 0);
    values_.assign(in_.level.values, in_.level.values + static_cast<size_t>(in_.level.wedge_count) * in_.columns);
    if (go_on_()) carry();
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

  // Both meshes in a box of unit diagonal.
  void load() {
    struct Box {
      double low[3] = {kInfinity, kInfinity, kInfinity}, high[3] = {-kInfinity, -kInfinity, -kInfinity};
      void grow(const double* a, const double* b) {
        for (int k = 0; k < 3; ++k) low[k] = std::min(low[k], a[k]), high[k] = std::max(high[k], b[k]);
      }
    };
    const FitMesh& original = in_.original;
    std::vector<Box> boxes(original.face_count / kGrain + 1);
    pool_.range(original.face_count, kGrain, [&](int begin, int end) {
      for (int64_t i = 3 * static_cast<int64_t>(begin); i < 3 * static_cast<int64_t>(end); ++i) {
        const double* p = original.positions + 3 * static_cast<int64_t>(original.faces[i]);
        boxes[begin / kGrain].grow(p, p);
      }
    });
    Box box;
    for (const Box& b : boxes) box.grow(b.low, b.high);
    if (!original.face_count) box = {{0, 0, 0}, {0, 0, 0}};
    const double half = std::hypot(box.high[0] / 2 - box.low[0] / 2, box.high[1] / 2 - box.low[1] / 2, box.high[2] / 2 - box.low[2] / 2);
    for (int k = 0; k < 3; ++k) center_[k] = box.low[k] / 2 + box.high[k] / 2;
    scale_ = half > 0 ? 0.5 / half : 1;
    const auto scale = [&](const FitMesh& mesh, std::vector<Vec3>& to) {
      to.resize(mesh.vertex_count);
      pool_.range(mesh.vertex_count, kGrain, [&](int begin, int end) {
        for (int v = begin; v < end; ++v) to[v] = scaled(mesh.positions + 3 * static_cast<int64_t>(v));
      });
    };
    scale(original, source_);
    scale(in_.level, at_);
    start_ = at_;
    if (in_.held) hold_seams();
  }

  // What holds the level's edges at which a chart ends: the less of what its two ends stand for.
  void hold_seams() {
    const int32_t *faces = in_.level.faces, *wedges = in_.level.wedges;
    std::vector<int32_t> vertex_of(in_.level.wedge_count);
    for (int64_t c = 0; c < 3 * static_cast<int64_t>(in_.level.face_count); ++c) vertex_of[wedges[c]] = faces[c];
    std::vector<float> held(in_.level.vertex_count, 0.0f);
    for (int64_t c = 0; c < 3 * static_cast<int64_t>(in_.original.face_count); ++c) {
      const int32_t to = in_.wedge_to[in_.original.wedges[c]];
      if (to < 0) continue;
      float& h = held[vertex_of[to]];
      h = std::max(h, in_.held[in_.original.faces[c]] * static_cast<float>(scale_));
    }
    held_.assign(3 * static_cast<size_t>(in_.level.face_count), 0.0f);
    pool_.range(in_.level.face_count, kGrain, [&](int begin, int end) {
      for (int64_t c = 3 * static_cast<int64_t>(begin); c < 3 * static_cast<int64_t>(end); ++c) {
        const int64_t to = c % 3 == 2 ? c - 2 : c + 1;
        const float h = std::min(held[faces[c]], held[faces[to]]);
        if (h > 0 && !continues(wedges[c], wedges[to])) held_[c] = h;
      }
    });
  }

  // Whether a face of the level has the edge the other way round, with the same wedges.
  bool continues(int32_t from, int32_t to) const {
    const Corners& corners = target_.wedges();
    for (int32_t i = corners.start[to]; i < corners.start[to + 1]; ++i) {
      const int32_t c = corners.list[i];
      if (in_.level.wedges[c % 3 == 2 ? c - 2 : c + 1] == from) return true;
    }
    return false;
  }

  // Samples of the original, on the nearest face of their chart. Those that find none are left out.
  void carry() {
    const FitMesh& original = in_.original;
    const int faces = original.face_count;
    std::vector<double> sum(static_cast<size_t>(faces) + 1, 0);
    pool_.range(faces, kGrain, [&](int begin, int end) {
      for (int f = begin; f < end; ++f) {
        const int32_t* v = original.faces + 3 * static_cast<int64_t>(f);
        const float* w = in_.importance;
        const float area = length(cross(source_[v[1]] - source_[v[0]], source_[v[2]] - source_[v[0]])) / 2;
        sum[f + 1] = w ? area * (w[v[0]] + w[v[1]] + w[v[2]]) / 3 : area;
      }
    });
    for (int f = 0; f < faces; ++f) sum[f + 1] += sum[f];
    const double dense = sum.back() > 0 ? options_.samples / sum.back() : 0;
    std::vector<int32_t> first(static_cast<size_t>(faces) + 1, 0);
    const bool each = dense > 0 && options_.samples >= faces;
    for (int f = 0; f < faces; ++f) {
      const double begin = sum[f] * dense, end = sum[f + 1] * dense;
      first[f + 1] = first[f] + (each ? rule(end - begin) : static_cast<int32_t>(std::floor(end + 0.5) - std::floor(begin + 0.5)));
    }
    const int count = first.back();
    share_ = static_cast<float>(sum.back() / std::max(count, 1));
    target_.place(at_);
    Large<Sample> samples(count);
    Large<Hit> hits(count);
    pool_.range(faces, kGrain, [&](int begin, int end) {
      int32_t guess = kNoFace;
      for (int f = begin; f < end; ++f) {
        int32_t to[3];
        for (int k = 0; k < 3; ++k) to[k] = in_.wedge_to[original.wedges[3 * static_cast<int64_t>(f) + k]];
        const int points = first[f + 1] - first[f];
        const auto weight = each ? static_cast<float>((sum[f + 1] - sum[f]) / points) : static_cast<float>(1 / dense);
        for (int i = first[f]; i < first[f + 1]; ++i) {
          samples[i] = sample(f, each && points <= 3 ? spot(i - first[f], points) : scattered(i), weight);
          hits[i] = target_.nearest(samples[i], to, guess);
          guess = hits[i].face;
        }
      }
    });
    sort(hits);
    samples_.resize(order_.size());
    hits_.resize(order_.size());
    pool_.range(static_cast<int>(order_.size()), kGrain, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) samples_[i] = samples[order_[i]], hits_[i] = hits[order_[i]], order_[i] = i;
    });
  }

  // Points of a face that the `wanted` ones of its share of the area are made with, if every face has some: its middle,
  // the three that integrate squares exactly, or many.
  static int32_t rule(double wanted) { return !(wanted > 0) ? 0 : wanted < 4 ? 1 : wanted < 48 ? 3 : 12; }

  struct Spot {
    float a1, a2;
  };
  static Spot spot(int number, int points) {
    if (points == 1) return {1.0f / 3, 1.0f / 3};
    return {number == 1 ? 2.0f / 3 : 1.0f / 6, number == 2 ? 2.0f / 3 : 1.0f / 6};
  }
  // The R2 sequence (Roberts 2018).
  static Spot scattered(int i) {
    // fractions of 1 as whole numbers: 0.5 + i / ρ and 0.5 + i / ρ², ρ³ = ρ + 1
    const auto part = [i](uint64_t step) {
      return static_cast<float>(((uint64_t{1} << 63) + static_cast<uint64_t>(i) * step) >> 40) * 0x1p-24f;
    };
    const float r = part(0xC13FA9A902A6328Fu), s = part(0x91E10DA5C79E7B1Du);
    return r + s > 1 ? Spot{1 - r, 1 - s} : Spot{r, s};
  }

  Sample sample(int32_t f, Spot spot, float weight) const {
    const int32_t* v = in_.original.faces + 3 * static_cast<int64_t>(f);
    const Vec3 a = source_[v[0]], ab = source_[v[1]] - a, ac = source_[v[2]] - a;
    return {a + ab * spot.a1 + ac * spot.a2, normalized(cross(ab, ac)), f, spot.a1, spot.a2, weight};
  }

  // The order of the samples by faces of the level: those of a face lie from starts_[f] to starts_[f + 1].
  void sort(const Large<Hit>& hits) {
    starts_.assign(static_cast<size_t>(in_.level.face_count) + 1, 0);
    for (const Hit& h : hits)
      if (h.face != kNoFace) ++starts_[h.face + 1];
    for (int f = 0; f < in_.level.face_count; ++f) starts_[f + 1] += starts_[f];
    order_.resize(starts_.back());
    std::vector<int32_t> next(starts_.begin(), starts_.end() - 1);
    for (size_t i = 0; i < hits.size(); ++i)
      if (hits[i].face != kNoFace) order_[next[hits[i].face]++] = static_cast<int32_t>(i);
  }

  // body(face, sample, hit) for the samples of each face, a face at a time.
  template <class Body>
  void samples_of(int32_t f, const Body& body) const {
    for (int32_t i = starts_[f]; i < starts_[f + 1]; ++i) body(samples_[order_[i]], hits_[order_[i]]);
  }

  // ---------------------------------------------------------------- positions

  // A vertex goes back if the samples round it came no nearer, or had been on the surface before.
  void move_where_it_pays() {
    const std::vector<Vec3> before = at_;
    move();
    target_.place(at_);
    const auto count = static_cast<int>(hits_.size());
    Large<Hit> hits(hits_.size());
    pool_.range(count, kGrain, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) hits[i] = target_.again(samples_[i], hits_[i]);
    });
    struct Sums {
      double was = 0, is = 0, count = 0;
    };
    std::vector<Sums> of(in_.level.face_count);
    pool_.range(in_.level.face_count, kGrain, [&](int begin, int end) {
      for (int f = begin; f < end; ++f)
        for (int32_t i = starts_[f]; i < starts_[f + 1]; ++i)
          if (const int32_t s = order_[i]; hits[s].face != kNoFace)
            of[f].was += hits_[s].distance2, of[f].is += hits[s].distance2, ++of[f].count;
    });
    std::vector<uint8_t> back(at_.size(), 0);
    pool_.range(vertices_.size(), kGrain, [&](int begin, int end) {
      for (int v = begin; v < end; ++v) {
        Sums sums;
        for (int32_t i = vertices_.start[v]; i < vertices_.start[v + 1]; ++i) {
          const Sums& s = of[vertices_.list[i] / 3];
          sums.was += s.was, sums.is += s.is, sums.count += s.count;
        }
        if (sums.is < sums.was && sums.was > kNear * kNear * sums.count) continue;
        at_[v] = before[v], back[v] = 1;
      }
    });
    target_.place(at_);
    const auto changed = [&](int32_t f) {
      const int32_t* v = in_.level.faces + 3 * static_cast<int64_t>(f);
      return f != kNoFace && (back[v[0]] || back[v[1]] || back[v[2]]);
    };
    pool_.range(count, kGrain, [&](int begin, int end) {
      for (int i = begin; i < end; ++i)
        if (hits[i].face == kNoFace || changed(hits[i].face)) hits[i] = target_.again(samples_[i], hits_[i]);
    });
    hits_ = std::move(hits);
    sort(hits_);
  }

  // The sum of s · bk · bl · metric over a face's samples, for its corners 00 01 02 11 12 22, and that of what is off.
  struct FaceSystem {
    std::array<Symmetric, 6> a;
    Vec3 r[3];
  };

  FaceSystem system(int32_t f) const {
    FaceSystem s{};
    const int32_t* u = in_.level.faces + 3 * static_cast<int64_t>(f);
    const Vec3 p[3] = {at_[u[0]], at_[u[1]], at_[u[2]]};
    samples_of(f, [&](const Sample& sample, const Hit& hit) {
      const Vec3 n = sample.normal;
      const float b[3] = {1 - hit.b1 - hit.b2, hit.b1, hit.b2};
      const Vec3 off = sample.at - (p[0] * b[0] + p[1] * b[1] + p[2] * b[2]);
      const Symmetric metric = {n.x * n.x + kTangential, n.x * n.y, n.x * n.z, n.y * n.y + kTangential, n.y * n.z,
                                n.z * n.z + kTangential};
      const Vec3 pull = metric * off * sample.weight;
      for (int k = 0, pair = 0; k < 3; ++k) {
        s.r[k] = s.r[k] + pull * b[k];
        for (int l = k; l < 3; ++l, ++pair)
          for (int i = 0; i < 6; ++i) s.a[pair][i] += sample.weight * b[k] * b[l] * metric[i];
      }
    });
    const float mass = kPrior * target_.doubled_area(f) / 24;
    for (int pair = 0; pair < 6; ++pair) {
      const float m = pair == 0 || pair == 3 || pair == 5 ? 2 * mass : mass;
      s.a[pair][0] += m, s.a[pair][3] += m, s.a[pair][5] += m;
    }
    for (int k = 0; in_.held && k < 3; ++k) {  // planes through the edge, perpendicular to the face
      const float h = held_[3 * static_cast<size_t>(f) + k];
      if (!(h > 0)) continue;
      const int l = (k + 1) % 3;
      const Vec3 e = p[l] - p[k], m = normalized(cross(e, cross(p[1] - p[0], p[2] - p[0])));
      const Vec3 w = m * (h * length(e));
      const Symmetric plane = {w.x * m.x, w.x * m.y, w.x * m.z, w.y * m.y, w.y * m.z, w.z * m.z};
      for (const int end : {k, l})
        for (int i = 0; i < 6; ++i) s.a[kPair[end][end]][i] += plane[i];
    }
    return s;
  }

  // min Σ w ‖x − Σ b (p + d)‖² in the metric n nᵀ + kTangential I, over the vertices' steps d.
  void move() {
    Large<FaceSystem> systems(in_.level.face_count);
    pool_.range(in_.level.face_count, kGrain, [&](int begin, int end) {
      for (int f = begin; f < end; ++f) systems[f] = system(f);
    });
    const Rows<Symmetric> rows(pool_, kGrain, vertices_, in_.level.faces,
                               [&](int32_t f, int k, int l) { return systems[f].a[kPair[k][l]]; });
    std::vector<Vec3> r(at_.size());
    pool_.range(vertices_.size(), kGrain, [&](int begin, int end) {
      for (int v = begin; v < end; ++v)
        for (int32_t i = vertices_.start[v]; i < vertices_.start[v + 1]; ++i)
          r[v] = r[v] + systems[vertices_.list[i] / 3].r[vertices_.list[i] % 3];
    });
    step(solve_points(pool_, kGrain, rows, r, kStop, go_on_));
  }

  // Moves all vertices, except where a face would turn over or become a sliver.
  void step(const std::vector<Vec3>& d) {
    const std::vector<Vec3> before = at_;
    std::vector<uint8_t> back(at_.size(), 0), bad(in_.level.face_count, 0);
    for (size_t v = 0; v < at_.size(); ++v) {
      const Vec3 to = at_[v] + d[v];
      if (std::isfinite(to.x) && std::isfinite(to.y) && std::isfinite(to.z)) at_[v] = to;
    }
    for (bool again = true; again;) {
      pool_.range(in_.level.face_count, kGrain, [&](int begin, int end) {
        for (int f = begin; f < end; ++f) bad[f] = turned(f, before, back);
      });
      again = false;
      for (int32_t f = 0; f < in_.level.face_count; ++f) {
        if (!bad[f]) continue;
        for (int k = 0; k < 3; ++k) {
          const int32_t v = in_.level.faces[3 * static_cast<int64_t>(f) + k];
          if (!back[v]) back[v] = 1, at_[v] = before[v], again = true;
        }
      }
    }
  }

  bool turned(int32_t f, const std::vector<Vec3>& before, const std::vector<uint8_t>& back) const {
    const int32_t* v = in_.level.faces + 3 * static_cast<int64_t>(f);
    if (back[v[0]] && back[v[1]] && back[v[2]]) return false;
    const auto normal = [&](const std::vector<Vec3>& at) { return cross(at[v[1]] - at[v[0]], at[v[2]] - at[v[0]]); };
    const Vec3 was = normal(before), is = normal(at_);
    const float a = dot(was, was), b = dot(is, is), c = dot(was, is);
    return a > 0 && !(c > 0 && c * c >= options_.flip_cos * options_.flip_cos * a * b && b > 0.04f * a);
  }

  // ---------------------------------------------------------------- values

  // min Σ w (value at the sample − Σ b value of the wedge)², each column for itself.
  void fit_values() {
    const std::vector<float> before = values_;
    std::vector<float> off;
    solve_values(off);
    if (options_.chart_column >= 0) keep_in_charts();
    std::vector<float> now;
    misfit(now, [](int32_t, float, const float*, const float*) {});
    for (size_t i = 0; i < values_.size(); ++i)
      if (!(now[i] < off[i]) || off[i] < kExact * kExact * share_) values_[i] = before[i];
  }

  // Σ w (value at the sample − Σ b value)² over the samples round each wedge, by columns. each(face, b, off) for all.
  template <class Each>
  void misfit(std::vector<float>& sums, const Each& each) {
    const int width = in_.columns;
    std::vector<float> of(static_cast<size_t>(in_.level.face_count) * width);
    pool_.range(in_.level.face_count, kGrain, [&](int begin, int end) {
      std::vector<float> off(width);
      for (int f = begin; f < end; ++f) {
        const int32_t* u = in_.level.wedges + 3 * static_cast<int64_t>(f);
        const float* level[3];
        for (int k = 0; k < 3; ++k) level[k] = values_.data() + static_cast<size_t>(u[k]) * width;
        float* square = of.data() + static_cast<size_t>(f) * width;
        samples_of(f, [&](const Sample& s, const Hit& hit) {
          const int32_t* w = in_.original.wedges + 3 * static_cast<int64_t>(s.source);
          const float b[3] = {1 - hit.b1 - hit.b2, hit.b1, hit.b2}, a[3] = {1 - s.a1 - s.a2, s.a1, s.a2};
          const float* given[3];
          for (int k = 0; k < 3; ++k) given[k] = in_.original.values + static_cast<size_t>(w[k]) * width;
          for (int c = 0; c < width; ++c) {
            off[c] = a[0] * given[0][c] - b[0] * level[0][c] + (a[1] * given[1][c] - b[1] * level[1][c]) +
                     (a[2] * given[2][c] - b[2] * level[2][c]);
            square[c] += s.weight * off[c] * off[c];
          }
          each(f, s.weight, b, off.data());
        });
      }
    });
    sums.assign(values_.size(), 0.0f);
    const Corners& wedges = target_.wedges();
    pool_.range(wedges.size(), kGrain, [&](int begin, int end) {
      for (int w = begin; w < end; ++w)
        for (int32_t i = wedges.start[w]; i < wedges.start[w + 1]; ++i)
          for (int c = 0; c < width; ++c)
            sums[static_cast<size_t>(w) * width + c] += of[static_cast<size_t>(wedges.list[i] / 3) * width + c];
    });
  }

  // Adds to the wedges' values what fits the samples best; `off` is what was off before.
  void solve_values(std::vector<float>& off) {
    const int width = in_.columns, lanes = (width + 3) / 4, faces = in_.level.face_count;
    std::vector<std::array<float, 6>> mass(faces);
    std::vector<float> right(static_cast<size_t>(faces) * 3 * width, 0.0f);
    for (int f = 0; f < faces; ++f) {
      const float m = kPrior * target_.doubled_area(f) / 24;
      mass[f] = {2 * m, m, m, 2 * m, m, 2 * m};
    }
    misfit(off, [&](int32_t f, float weight, const float* b, const float* missing) {
      for (int k = 0, pair = 0; k < 3; ++k)
        for (int l = k; l < 3; ++l, ++pair) mass[f][pair] += weight * b[k] * b[l];
      float* to = right.data() + static_cast<size_t>(f) * 3 * width;
      for (int k = 0; k < 3; ++k)
        for (int c = 0; c < width; ++c) to[k * width + c] += weight * b[k] * missing[c];
    });
    const Corners& wedges = target_.wedges();
    const Rows<float> rows(pool_, kGrain, wedges, in_.level.wedges, [&](int32_t f, int k, int l) { return mass[f][kPair[k][l]]; });
    Large<Lanes> r(static_cast<size_t>(wedges.size()) * lanes);
    pool_.range(wedges.size(), kGrain, [&](int begin, int end) {
      for (int w = begin; w < end; ++w) {
        std::fill_n(&r[static_cast<size_t>(w) * lanes], lanes, Lanes{});
        for (int32_t i = wedges.start[w]; i < wedges.start[w + 1]; ++i)
          for (int c = 0; c < width; ++c)
            r[static_cast<size_t>(w) * lanes + c / 4][c % 4] += right[static_cast<size_t>(wedges.list[i]) * width + c];
      }
    });
    const Large<Lanes> x = solve_columns(pool_, kGrain, rows, r, lanes, kStop, go_on_);
    pool_.range(wedges.size(), kGrain, [&](int begin, int end) {
      for (int w = begin; w < end; ++w)
        for (int c = 0; c < width; ++c) {
          float& value = values_[static_cast<size_t>(w) * width + c];
          if (const float to = value + x[static_cast<size_t>(w) * lanes + c / 4][c % 4]; std::isfinite(to)) value = to;
        }
    });
  }

  // At the border of a chart a fit may reach beyond it, where the texture shows something else: no farther from what
  // the samples round the wedge show than a gutter.
  void keep_in_charts() {
    const Corners& wedges = target_.wedges();
    pool_.range(wedges.size(), kGrain, [&](int begin, int end) {
      for (int w = begin; w < end; ++w)
        if (at_border(w)) keep_in_chart(w);
    });
  }

  void keep_in_chart(int32_t w) {
    const Corners& wedges = target_.wedges();
    const int u = options_.chart_column;
    const size_t width = in_.columns;
    const float* start = in_.level.values + w * width + u;
    float low[2] = {start[0], start[1]}, high[2] = {start[0], start[1]};
    for (int32_t i = wedges.start[w]; i < wedges.start[w + 1]; ++i)
      samples_of(wedges.list[i] / 3, [&](const Sample& s, const Hit&) {
        const int32_t* of = in_.original.wedges + 3 * static_cast<int64_t>(s.source);
        for (int k = 0; k < 2; ++k) {
          const auto given = [&](int corner) { return in_.original.values[of[corner] * width + u + k]; };
          const float at = (1 - s.a1 - s.a2) * given(0) + s.a1 * given(1) + s.a2 * given(2);
          low[k] = std::min(low[k], at), high[k] = std::max(high[k], at);
        }
      });
    for (int k = 0; k < 2; ++k) {
      float& x = values_[w * width + u + k];
      x = std::clamp(x, low[k] - kGutter, high[k] + kGutter);
    }
  }

  // Whether the faces that have the wedge leave a gap: then other wedges leave by an edge than enter by one.
  bool at_border(int32_t w) const {
    const Corners& wedges = target_.wedges();
    uint64_t balance = 0;
    const auto mix = [](int32_t x) { return static_cast<uint64_t>(x + 1) * 0x9E3779B97F4A7C15u; };
    for (int32_t i = wedges.start[w]; i < wedges.start[w + 1]; ++i) {
      const int32_t* of = in_.level.wedges + 3 * static_cast<int64_t>(wedges.list[i] / 3);
      const int k = wedges.list[i] % 3;
      balance += mix(of[(k + 1) % 3]) - mix(of[(k + 2) % 3]);
    }
    return balance != 0;
  }

  const FitInput& in_;
  const FitOptions& options_;
  const std::function<bool()>& go_on_;
  Pool pool_;
  Target target_;
  Corners vertices_;         // of the level
  std::vector<float> held_;  // for each corner of the level, how strongly the edge to the next holds its place
  double center_[3] = {0, 0, 0}, scale_ = 1;
  std::vector<Vec3> source_, at_, start_;  // vertices of the original, of the level, of the level at first
  Large<Sample> samples_;
  Large<Hit> hits_;
  std::vector<int32_t> starts_, order_;  // of the samples, by faces of the level
  float share_ = 0;                      // area for each sample, the mean
  std::vector<float> values_;
};

}  // namespace

FitResult fit(const FitInput& input, const FitOptions& options, const std::function<bool()>& go_on) {
  return Fit(input, options, go_on).run();
}

}  // namespace lodpipe
