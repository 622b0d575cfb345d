// Texture deviation (Cohen, Olano & Manocha 1998, "Appearance-preserving simplification"): how far apart in space the
// points of equal UV lie before and after. Each face has a box that holds the way back to the original surface from
// every point of it; the cost is the farthest corner of the boxes that a collapse would make.
#include <algorithm>

#include "cost.h"
#include "overlap.h"

namespace lodpipe::similarity {
namespace {

struct Box {
  Point low, high;
  bool empty = true;
  void add(Point p) {
    if (empty) low = high = p, empty = false;
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
  double farthest() const {
    return length({std::max(-low.x, high.x), std::max(-low.y, high.y), std::max(-low.z, high.z)});
  }
};

class DeviationCost final : public Cost {
 public:
  DeviationCost(const Mesh& mesh, const Scene& scene, const Options& options)
      : mesh_(mesh), scene_(scene), accumulates_(options.reference == Reference::original) {
    boxes_.resize(mesh.faces.size());
    for (Box& box : boxes_) box.add({});
  }

  double evaluate(const Collapse& c, CostScratch&) const override {
    if (c.after.empty()) return extent(c);  // nothing is left to compare with
    double most = uncovered(c);
    for (const int32_t f : c.after) most = std::max(most, box_after(c, f).farthest());
    return most;
  }

  void commit(const Collapse& c, CostScratch&) override {
    std::vector<Box> made;
    for (const int32_t f : c.after) made.push_back(box_after(c, f));
    if (accumulates_)
      for (size_t i = 0; i < made.size(); ++i) boxes_[c.after[i]] = made[i];
  }

 private:
  bool same_look(int32_t a, int32_t b) const {
    return scene_.face_look[mesh_.faces[a].source] == scene_.face_look[mesh_.faces[b].source];
  }

  Box box_after(const Collapse& c, int32_t face) const {
    thread_local std::vector<Uv> polygon, spare;
    const UvTriangle now(mesh_, c, face, true, scene_.uv_column);
    Box box;
    for (const int32_t g : c.before) {
      if (!same_look(face, g)) continue;
      const UvTriangle old(mesh_, c, g, false, scene_.uv_column);
      now.common(old, polygon, spare);
      for (const Uv& at : polygon) {  // the way is linear on what both cover: its corners tell
        const Point way = place(c, g, old, at, false) - place(c, face, now, at, true);
        box.add(way + boxes_[g].low);
        box.add(way + boxes_[g].high);
      }
    }
    if (!box.empty) return box;
    box = boxes_[face];  // UVs without area: the vertex's own way
    const Point way = mesh_.p[c.gone] - c.place;
    box.add(box.low + way), box.add(box.high + way);
    return box;
  }

  Point place(const Collapse& c, int32_t face, const UvTriangle& triangle, Uv at, bool after) const {
    double share[3];
    triangle.weights(at, share);
    Point x;
    for (int k = 0; k < 3; ++k) x = x + corner_of(mesh_, c, mesh_.faces[face], k, after).x * share[k];
    return x;
  }

  // Where the UV of the vertex that goes is covered no more (a corner of a border is cut off): how far away it was.
  double uncovered(const Collapse& c) const {
    for (const int32_t g : c.before) {
      const Face& face = mesh_.faces[g];
      if (!face.has(c.gone) || scene_.uv_column < 0) continue;
      const float* value = mesh_.values(face.w[face.slot(c.gone)]) + scene_.uv_column;
      bool covered = false;
      for (const int32_t f : c.after) {
        const UvTriangle now(mesh_, c, f, true, scene_.uv_column);
        if (covered || !same_look(f, g) || now.flat()) continue;
        double share[3];
        now.weights({value[0], value[1]}, share);
        covered = std::min({share[0], share[1], share[2]}) > -1e-4;
      }
      if (!covered) return length(mesh_.p[c.gone] - c.place);
    }
    return 0;
  }

  double extent(const Collapse& c) const {
    double most = 0;
    for (const int32_t f : c.before)
      for (const int32_t v : mesh_.faces[f].v) most = std::max(most, length(mesh_.p[v] - mesh_.p[c.gone]));
    return most;
  }

  const Mesh& mesh_;
  const Scene& scene_;
  bool accumulates_;
  std::vector<Box> boxes_;
};

}  // namespace

std::unique_ptr<Cost> make_deviation_cost(const Mesh& mesh, const Scene& scene, const Options& options) {
  return std::make_unique<DeviationCost>(mesh, scene, options);
}

}  // namespace lodpipe::similarity
