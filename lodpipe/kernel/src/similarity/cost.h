// What a collapse costs: one class for each metric.
#pragma once
#include <memory>
#include <vector>

#include "mesh.h"
#include "patch.h"

namespace lodpipe::similarity {

// Working memory of one thread.
struct CostScratch {
  Patch before, after, original;
  Rays rays;
  Caster first, second;
  std::vector<Vec3> samples;
  std::vector<int32_t> vertices, faces;
  std::vector<uint32_t> mark;  // of faces, by `marker`
  uint32_t marker = 0;

  // Starts a new set of marked faces among `count`.
  void unmark(size_t count) {
    if (mark.size() < count) mark.resize(count, 0);
    if (++marker == 0) std::fill(mark.begin(), mark.end(), 0), marker = 1;
  }
  bool take(int32_t face) { return mark[face] != marker && (mark[face] = marker, true); }
};

class Cost {
 public:
  virtual ~Cost() = default;
  // Of a planned collapse, ≥ 0 but for the image metric; several threads may ask at the same time.
  virtual double evaluate(const Collapse& c, CostScratch& s) const = 0;
  // Whether a cost stays the same until something changes in the region.
  virtual bool lasts() const { return true; }
  // Called before the mesh carries the collapse out.
  virtual void commit(const Collapse& c, CostScratch& s) = 0;
};

std::unique_ptr<Cost> make_ray_cost(const Mesh& mesh, const Scene& scene, const Options& options);
std::unique_ptr<Cost> make_deviation_cost(const Mesh& mesh, const Scene& scene, const Options& options);
std::unique_ptr<Cost> make_image_cost(const Mesh& mesh, const Scene& scene, const Options& options);

// Corner k of a face of the region as it is, or (`after`) as it would be.
struct CornerOf {
  Point x;
  const float* values;
  const double* fresh;  // instead of `values` where it is not null
  double value(int column) const { return fresh ? fresh[column] : static_cast<double>(values[column]); }
};
CornerOf corner_of(const Mesh& mesh, const Collapse& c, const Face& face, int k, bool after);

// Adds a face to a patch whose coordinates are (x − center) × scale.
void add_face(const Mesh& mesh, const Shading& shading, const Collapse& c, int32_t face, int look, bool after,
              Point center, double scale, Patch& out);

}  // namespace lodpipe::similarity
