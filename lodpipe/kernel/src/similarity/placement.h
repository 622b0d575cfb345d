// Where a full-edge collapse puts the merged vertex: Garland & Heckbert 1998, in the five dimensions of place and UV.
//
// A vertex with several wedges has a quadric for each; merging minimises their sum over one place and a UV for every
// group of wedges that becomes one, by eliminating the UVs first (Schur complement).
#pragma once
#include <array>

#include "mesh.h"

namespace lodpipe::similarity {

// E(x) = xᵀAx + 2b·x + c in R⁵: A in rows of its upper triangle.
struct Quadric5 {
  std::array<double, 15> a{};
  std::array<double, 5> b{};
  double c = 0;
  static constexpr int at(int i, int j) { return i <= j ? i * 5 - i * (i - 1) / 2 + j - i : at(j, i); }
  double get(int i, int j) const { return a[at(i, j)]; }
  Quadric5& operator+=(const Quadric5& q) {
    for (int i = 0; i < 15; ++i) a[i] += q.a[i];
    for (int i = 0; i < 5; ++i) b[i] += q.b[i];
    c += q.c;
    return *this;
  }
};

// The part of it that is left when the UV is chosen best for each place: xᵀAx + 2b·x + c in R³.
struct Quadric3 {
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0, bx = 0, by = 0, bz = 0, c = 0;
  void add_plane(Point n, double d, double w) {
    xx += w * n.x * n.x, xy += w * n.x * n.y, xz += w * n.x * n.z, yy += w * n.y * n.y, yz += w * n.y * n.z;
    zz += w * n.z * n.z, bx += w * d * n.x, by += w * d * n.y, bz += w * d * n.z, c += w * d * d;
  }
  Quadric3& operator+=(const Quadric3& q) {
    xx += q.xx, xy += q.xy, xz += q.xz, yy += q.yy, yz += q.yz, zz += q.zz;
    bx += q.bx, by += q.by, bz += q.bz, c += q.c;
    return *this;
  }
  double trace() const { return xx + yy + zz; }
  double at(Point p) const {
    return p.x * (xx * p.x + 2 * (xy * p.y + xz * p.z + bx)) + p.y * (yy * p.y + 2 * (yz * p.z + by)) +
           p.z * (zz * p.z + 2 * bz) + c;
  }
};

class Placement {
 public:
  Placement(const Mesh& mesh, int uv_column);

  // Root mean square distance of `x` to the planes of v and u together.
  double deviation(int32_t v, int32_t u, Point x) const;
  // The best place for the groups (each a list of wedges of v and u), and its UV for each group in `uv`.
  Point best(const Mesh& mesh, int32_t v, int32_t u, const std::vector<std::vector<int32_t>>& groups,
             std::vector<std::array<double, 2>>& uv) const;
  void merge(const Collapse& c);
  bool steers_uv() const { return uv_scale_ > 0; }

 private:
  std::vector<Quadric5> wedge_;
  std::vector<Quadric3> planes_, hold_;  // of the faces, weighted by area; of borders and seams
  int uv_column_;
  double uv_scale_ = 0;
};

}  // namespace lodpipe::similarity
