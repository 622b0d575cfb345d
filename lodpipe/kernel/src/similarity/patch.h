// A handful of triangles in coordinates of their own, and what rays from one viewpoint see of them.
#pragma once
#include <cstdint>
#include <vector>

#include "../quadric.h"
#include "similarity.h"
#include "vector.h"

namespace lodpipe::similarity {

constexpr int kBlock = 16;            // rays that are tested together
constexpr float kEdgeTolerance = 1e-5f;  // barycentric: no ray slips through between two triangles

// What is at a corner of a triangle: unit normal, texture coordinates, luminance and alpha of the vertex colour.
struct Corner {
  float n[3], u, v, tint, alpha;
};

// Reads corners from values as the scene describes them.
class Shading {
 public:
  explicit Shading(const Scene& scene) : scene_(scene) {}
  template <class Value>
  Corner corner(const Value* values, int look, Point flat) const;
  const Look& look(int i) const { return scene_.looks[i]; }
  // Luminance and alpha of the texture at (u, v), 1 and 1 without one.
  void texel(const Look& look, float u, float v, float out[2]) const;

 private:
  const Scene& scene_;
};

// Triangles about the origin. `x` has three points a triangle, `corners` too.
struct Patch {
  std::vector<Vec3> x;
  std::vector<Corner> corners;
  std::vector<int32_t> look;
  std::vector<Lanes> four;  // `x` of four triangles at a time: nine coordinates; the last four are filled up
  int size() const { return static_cast<int>(look.size()); }
  void clear() { x.clear(), corners.clear(), look.clear(), four.clear(); }
  void pack();              // fills `four`, once all triangles are there
};

// Rays from one viewpoint through sample points, in blocks; the last block is filled up.
struct Rays {
  Vec3 origin;
  int count = 0;
  std::vector<float> x, y, z;      // directions: a ray reaches its sample at t = 1
  std::vector<float> low, high;    // bounds of 1 / t within which a hit counts
  Vec3 right, up, back;            // of the plane that blocks are compared in
  std::vector<float> bounds;       // of each block there: least and most across, least and most up
  float all[4];                    // of all of them

  void aim(Vec3 from, const std::vector<Vec3>& samples);
  // Only hits within `radius` of the origin of coordinates count from now on.
  void within(float radius);

 private:
  void pad_and_bound();
};

struct Hit {
  int triangle = -1;
  float inverse = 0;  // 1 / t
  float weights[3];   // barycentric
};

// Finds the nearest hits of rays with patches.
class Caster {
 public:
  void cast(const Rays& rays, Patch& patch);
  Hit hit(const Rays& rays, const Patch& patch, int ray) const;  // with the patch that was cast on
  int triangle(int ray) const { return triangle_[ray]; }
  // Whether the ray meets something at least as near as 1 / inverse.
  bool nearer(int ray, float inverse) const { return triangle_[ray] >= 0 && inverse_[ray] >= inverse; }

 private:
  struct Plane {
    Vec3 n[3];          // a ray d is inside where all n·d have one sign
    float per_volume;   // 1 / t = Σ n·d × this
  };
  std::vector<Plane> planes_;
  std::vector<float> bounds_;  // of each triangle, as Rays::bounds
  std::vector<int32_t> usable_;
  std::vector<float> inverse_;
  std::vector<int32_t> triangle_;
};

// Cost(R, M) of Liao 2004, (3.1): texture luminance × l·N with the light at the viewpoint, and `missing` as far as the
// surface lets it through.
float colour(const Shading& shading, const Patch& patch, const Hit& hit, Vec3 direction, float missing);

template <class Value>
Corner Shading::corner(const Value* values, int look_row, Point flat) const {
  const Look& look = scene_.looks[look_row];
  Corner c{{static_cast<float>(flat.x), static_cast<float>(flat.y), static_cast<float>(flat.z)}, 0, 0, 1, 1};
  if (scene_.shade_column >= 0) {
    const Value* s = values + scene_.shade_column;
    if (s[0] != 0 || s[1] != 0 || s[2] != 0)
      for (int k = 0; k < 3; ++k) c.n[k] = static_cast<float>(s[k]);
    c.tint = static_cast<float>(s[3]), c.alpha = static_cast<float>(s[4]);
  }
  if (look.uv_column >= 0) {
    const auto u = static_cast<float>(values[look.uv_column]), v = static_cast<float>(values[look.uv_column + 1]);
    c.u = look.matrix[0] * u + look.matrix[1] * v + look.matrix[2];
    c.v = look.matrix[3] * u + look.matrix[4] * v + look.matrix[5];
  }
  return c;
}

}  // namespace lodpipe::similarity
