// Visual similarity (Liao 2004, section 3.2): rays from viewpoints round the region to points on it, and how differently
// bright what they meet is before and after, or on the original mesh and after. The sum, not the mean.
#include <algorithm>
#include <optional>

#include "bvh.h"
#include "cost.h"
#include "overlap.h"
#include "sampling.h"

namespace lodpipe::similarity {
namespace {

constexpr float kMissing = 0.5f;      // half of the brightest light: what is where nothing is met
constexpr double kDistance = 2;       // of the viewpoints, in distances of the region's farthest vertex
constexpr double kReach = 1.25;       // in the same: the original counts within this distance of the centre
constexpr double kMostSamples = 1024;  // of a region; beyond, scan lines lie farther apart and rays weigh more

class RayCost final : public Cost {
 public:
  RayCost(const Mesh& mesh, const Scene& scene, const Options& options)
      : mesh_(mesh), scene_(scene), options_(options), shading_(scene), directions_(hemisphere(options.views)),
        step_(options.spacing * std::sqrt(2 * mesh.mean_area)) {
    if (options.reference == Reference::previous) return;
    for (const Face& face : mesh.faces) {
      const int row = scene.face_look[face.source];
      const Point flat = cross(mesh.p[face.v[1]] - mesh.p[face.v[0]], mesh.p[face.v[2]] - mesh.p[face.v[0]]);
      for (int k = 0; k < 3; ++k) {
        original_.x.push_back(mesh.p[face.v[k]]);
        original_.corners.push_back(shading_.corner(mesh.values(face.w[k]), row, flat));
      }
      original_.look.push_back(row);
    }
    if (options.correspondence == Correspondence::uv) {
      sets_.resize(mesh.faces.size());
      for (size_t f = 0; f < sets_.size(); ++f) sets_[f] = {static_cast<int32_t>(f)};
      return;
    }
    std::vector<BoxTree::Box> boxes(mesh.faces.size());
    for (size_t f = 0; f < boxes.size(); ++f)
      for (const int32_t v : mesh.faces[f].v) boxes[f].add(mesh.p[v]);
    tree_.emplace(std::move(boxes));
  }

  double evaluate(const Collapse& c, CostScratch& s) const override {
    Point center, axis;
    double area = 0;
    const double farthest = measure(c, s, &center, &axis, &area);
    if (!(farthest > 0) || !(step_ > 0)) return 0;
    const double scale = 1 / farthest;
    s.before.clear(), s.after.clear();
    for (const int32_t f : c.after) add_face(mesh_, shading_, c, f, look(f), true, center, scale, s.after);
    const bool local = options_.reference == Reference::previous;
    if (!local) gather_original(c, s, center, farthest);
    else
      for (const int32_t f : c.before) add_face(mesh_, shading_, c, f, look(f), false, center, scale, s.before);
    const double step = std::max(step_, std::sqrt(area / kMostSamples));
    s.samples.clear();
    for (const int32_t f : c.before) {
      const int32_t* v = mesh_.faces[f].v;
      scan_lines((mesh_.p[v[0]] - center) * scale, (mesh_.p[v[1]] - center) * scale, (mesh_.p[v[2]] - center) * scale,
                 step * scale, s.samples);
    }
    Patch& reference = local ? s.before : s.original;
    const Frame frame(axis);
    double sum = 0;
    for (const Point& direction : directions_) {
      const Point from = frame.turned(direction) * kDistance;
      s.rays.aim({static_cast<float>(from.x), static_cast<float>(from.y), static_cast<float>(from.z)}, s.samples);
      s.second.cast(s.rays, s.after);
      if (!local) s.rays.within(static_cast<float>(kReach));
      s.first.cast(s.rays, reference);
      for (int i = 0; i < s.rays.count; ++i) sum += difference(s, reference, i, static_cast<float>(direction.z));
    }
    return sum * (step / step_) * (step / step_);
  }

  void commit(const Collapse& c, CostScratch& s) override {
    if (sets_.empty()) return;
    std::vector<std::vector<int32_t>> merged(c.after.size());
    for (size_t i = 0; i < c.after.size(); ++i) {
      const int32_t f = c.after[i];
      const UvTriangle now(mesh_, c, f, true, uv_column(f));
      for (const bool all : {false, true}) {  // all of them where the UVs cannot tell
        s.unmark(original_.look.size());
        for (const int32_t g : c.before)
          if (all || (look(f) == look(g) && now.overlaps(UvTriangle(mesh_, c, g, false, uv_column(g)))))
            for (const int32_t o : sets_[g])
              if (s.take(o)) merged[i].push_back(o);
        if (!merged[i].empty()) break;
      }
    }
    for (const int32_t f : c.removed) sets_[f] = {};
    for (size_t i = 0; i < c.after.size(); ++i) sets_[c.after[i]] = std::move(merged[i]);
  }

 private:
  int look(int32_t face) const { return scene_.face_look[mesh_.faces[face].source]; }
  int uv_column(int32_t face) const {
    const int column = scene_.looks[look(face)].uv_column;
    return column >= 0 ? column : scene_.uv_column;
  }

  // Centre of the region's vertices, its mean normal and area; the distance of its farthest vertex.
  double measure(const Collapse& c, CostScratch& s, Point* center, Point* axis, double* area) const {
    s.vertices.clear();
    Point normal;
    for (const int32_t f : c.before) {
      const Face& face = mesh_.faces[f];
      s.vertices.insert(s.vertices.end(), face.v, face.v + 3);
      const Point n = mesh_.area_vector(face);
      normal = normal + n;
      *area += length(n);
    }
    std::sort(s.vertices.begin(), s.vertices.end());
    s.vertices.erase(std::unique(s.vertices.begin(), s.vertices.end()), s.vertices.end());
    for (const int32_t v : s.vertices) *center = *center + mesh_.p[v] * (1.0 / static_cast<double>(s.vertices.size()));
    double farthest = 0;
    for (const int32_t v : s.vertices) farthest = std::max(farthest, length(mesh_.p[v] - *center));
    const double size = length(normal);
    *axis = size > 1e-12 * *area ? normal * (1 / size) : Point{0, 0, 1};
    return farthest;
  }

  void gather_original(const Collapse& c, CostScratch& s, Point center, double farthest) const {
    s.faces.clear();
    if (tree_) tree_->near(center, kReach * farthest, s.faces);
    else {
      s.unmark(original_.look.size());
      for (const int32_t f : c.before)
        for (const int32_t o : sets_[f])
          if (s.take(o)) s.faces.push_back(o);
    }
    s.original.clear();
    const double scale = 1 / farthest;
    for (const int32_t o : s.faces) {
      const size_t first = 3 * static_cast<size_t>(o);
      for (size_t k = first; k < first + 3; ++k) {
        const Point x = (original_.x[k] - center) * scale;
        s.original.x.push_back({static_cast<float>(x.x), static_cast<float>(x.y), static_cast<float>(x.z)});
        s.original.corners.push_back(original_.corners[k]);
      }
      s.original.look.push_back(original_.look[o]);
    }
  }

  // d_RMS(R, M_a, M_b) of one ray (3.3). `top` is the cosine between the viewpoint's direction and the region's normal.
  double difference(const CostScratch& s, const Patch& reference, int ray, float top) const {
    const bool first = s.first.triangle(ray) >= 0, second = s.second.triangle(ray) >= 0;
    if (!first && !second) return 0;
    const Vec3 d{s.rays.x[ray], s.rays.y[ray], s.rays.z[ray]};
    const float a = first ? colour(shading_, reference, s.first.hit(s.rays, reference, ray), d, kMissing) : kMissing;
    const float b = second ? colour(shading_, s.after, s.second.hit(s.rays, s.after, ray), d, kMissing) : kMissing;
    if (first != second && options_.penalty == Penalty::view) return 0.5 + 0.5 * top;
    return std::abs(a - b);
  }

  const Mesh& mesh_;
  const Scene& scene_;
  const Options& options_;
  Shading shading_;
  std::vector<Point> directions_;
  double step_;
  struct {  // three of the first two for each triangle
    std::vector<Point> x;
    std::vector<Corner> corners;
    std::vector<int32_t> look;
  } original_;
  std::vector<std::vector<int32_t>> sets_;  // S_t: the original triangles that a live one stands for
  std::optional<BoxTree> tree_;
};

}  // namespace

std::unique_ptr<Cost> make_ray_cost(const Mesh& mesh, const Scene& scene, const Options& options) {
  return std::make_unique<RayCost>(mesh, scene, options);
}

}  // namespace lodpipe::similarity
