// Triangles in the UV plane: whether two share area, and the corners of what they share.
#pragma once
#include <algorithm>
#include <vector>

#include "cost.h"

namespace lodpipe::similarity {

struct Uv {
  double u = 0, v = 0;
};

struct UvTriangle {
  Uv at[3];

  UvTriangle(const Mesh& mesh, const Collapse& c, int32_t face, bool after, int column) {
    if (column < 0) return;
    for (int k = 0; k < 3; ++k) {
      const CornerOf corner = corner_of(mesh, c, mesh.faces[face], k, after);
      at[k] = {corner.value(column), corner.value(column + 1)};
    }
  }

  static double turn(Uv a, Uv b, Uv c) { return (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u); }
  double doubled_area() const { return turn(at[0], at[1], at[2]); }
  double width() const {  // of its box
    double low_u = at[0].u, high_u = low_u, low_v = at[0].v, high_v = low_v;
    for (const Uv& p : at)
      low_u = std::min(low_u, p.u), high_u = std::max(high_u, p.u), low_v = std::min(low_v, p.v), high_v = std::max(high_v, p.v);
    return std::max(high_u - low_u, high_v - low_v);
  }
  bool flat() const { return !(std::abs(doubled_area()) > 1e-10 * width() * width()); }

  // The convex polygon that both cover, empty if they only touch; by Sutherland & Hodgman.
  void common(const UvTriangle& other, std::vector<Uv>& out, std::vector<Uv>& spare) const {
    out.clear();
    if (flat() || other.flat()) return;
    out.assign(at, at + 3);
    const double sign = other.doubled_area() > 0 ? 1 : -1;
    for (int k = 0; k < 3 && !out.empty(); ++k) {
      const Uv a = other.at[k], b = other.at[(k + 1) % 3];
      spare.clear();
      for (size_t i = 0; i < out.size(); ++i) {
        const Uv p = out[i], q = out[(i + 1) % out.size()];
        const double x = sign * turn(a, b, p), y = sign * turn(a, b, q);
        if (x >= 0) spare.push_back(p);
        if ((x > 0 && y < 0) || (x < 0 && y > 0)) {
          const double part = x / (x - y);
          spare.push_back({p.u + part * (q.u - p.u), p.v + part * (q.v - p.v)});
        }
      }
      out.swap(spare);
    }
    double area = 0;
    for (size_t i = 1; i + 1 < out.size(); ++i) area += turn(out[0], out[i], out[i + 1]);
    const double least = std::min(std::abs(doubled_area()), std::abs(other.doubled_area()));
    if (!(std::abs(area) > 1e-6 * least)) out.clear();
  }

  bool overlaps(const UvTriangle& other) const {
    thread_local std::vector<Uv> polygon, spare;
    common(other, polygon, spare);
    return !polygon.empty();
  }

  // Barycentric coordinates of p; the triangle is not flat.
  void weights(Uv p, double out[3]) const {
    const double whole = doubled_area();
    for (int k = 0; k < 3; ++k) out[k] = turn(p, at[(k + 1) % 3], at[(k + 2) % 3]) / whole;
  }
};

}  // namespace lodpipe::similarity
