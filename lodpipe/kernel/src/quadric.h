// Quadrics: squared distance to planes (Garland & Heckbert 1997) and to linear attribute functions (Hoppe 1999).
//
// Every quadric has its origin at its own vertex, E(x) = yᵀAy + 2b·y + c with y = x − vertex. Numbers then are of the
// size of the neighbourhood instead of the model, so that 32-bit floats are exact enough for millions of triangles.
#pragma once
#include <cmath>
#include <limits>

namespace lodpipe {

using Lanes = float __attribute__((vector_size(16)));  // four numbers in one register

// Rows become columns.
inline void transpose(Lanes& a, Lanes& b, Lanes& c, Lanes& d) {
#if defined(__clang__)
#define LODPIPE_SHUFFLE(x, y, i, j, k, l) __builtin_shufflevector(x, y, i, j, k, l)
#else
  using Order = int __attribute__((vector_size(16)));
#define LODPIPE_SHUFFLE(x, y, i, j, k, l) __builtin_shuffle(x, y, Order{i, j, k, l})
#endif
  const Lanes ab = LODPIPE_SHUFFLE(a, b, 0, 4, 1, 5), cd = LODPIPE_SHUFFLE(c, d, 0, 4, 1, 5);
  const Lanes ab2 = LODPIPE_SHUFFLE(a, b, 2, 6, 3, 7), cd2 = LODPIPE_SHUFFLE(c, d, 2, 6, 3, 7);
  a = LODPIPE_SHUFFLE(ab, cd, 0, 1, 4, 5), b = LODPIPE_SHUFFLE(ab, cd, 2, 3, 6, 7);
  c = LODPIPE_SHUFFLE(ab2, cd2, 0, 1, 4, 5), d = LODPIPE_SHUFFLE(ab2, cd2, 2, 3, 6, 7);
#undef LODPIPE_SHUFFLE
}

constexpr float kInfinity = std::numeric_limits<float>::infinity();

struct Vec3 {
  float x = 0, y = 0, z = 0;
};
inline Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec3 operator*(Vec3 a, float s) { return {a.x * s, a.y * s, a.z * s}; }
inline float dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 cross(Vec3 a, Vec3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline float length(Vec3 a) { return std::sqrt(dot(a, a)); }
inline Vec3 normalized(Vec3 a) {
  const float l = length(a);
  return l > 0 ? a * (1 / l) : Vec3{};
}

struct Quadric {
  float xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;  // A
  float bx = 0, by = 0, bz = 0;                          // b
  float c = 0;

  // w · (n·y + d)²
  void add_plane(Vec3 n, float d, float w) {
    const Vec3 m = n * w;
    xx += m.x * n.x, xy += m.x * n.y, xz += m.x * n.z, yy += m.y * n.y, yz += m.y * n.z, zz += m.z * n.z;
    bx += m.x * d, by += m.y * d, bz += m.z * d;
    c += w * d * d;
  }
  // w · (n·y)²
  void add_plane(Vec3 n, float w) {
    const Vec3 m = n * w;
    xx += m.x * n.x, xy += m.x * n.y, xz += m.x * n.z, yy += m.y * n.y, yz += m.y * n.z, zz += m.z * n.z;
  }
  Quadric& operator+=(const Quadric& q) {
    xx += q.xx, xy += q.xy, xz += q.xz, yy += q.yy, yz += q.yz, zz += q.zz;
    bx += q.bx, by += q.by, bz += q.bz, c += q.c;
    return *this;
  }
  Quadric& operator*=(float s) {
    xx *= s, xy *= s, xz *= s, yy *= s, yz *= s, zz *= s, bx *= s, by *= s, bz *= s, c *= s;
    return *this;
  }
  Vec3 times(Vec3 t) const {
    return {xx * t.x + xy * t.y + xz * t.z, xy * t.x + yy * t.y + yz * t.z, xz * t.x + yz * t.y + zz * t.z};
  }
  float at(Vec3 y) const { return dot(times(y), y) + 2 * (bx * y.x + by * y.y + bz * y.z) + c; }
  float trace() const { return xx + yy + zz; }

  // The same function about an origin that lies `t` further on.
  void move_origin(Vec3 t) {
    const Vec3 at = times(t);
    c += 2 * (bx * t.x + by * t.y + bz * t.z) + dot(at, t);
    bx += at.x, by += at.y, bz += at.z;
  }

  // Minimiser of E(y) + damping · |y − toward|². False if the system is not well conditioned.
  bool minimise(float damping, Vec3 toward, Vec3* y) const {
    const float a = xx + damping, d = yy + damping, f = zz + damping;
    const float rx = damping * toward.x - bx, ry = damping * toward.y - by, rz = damping * toward.z - bz;
    // cofactors of the symmetric matrix: one division, and the same instructions in every lane of a vector
    const float cxx = d * f - yz * yz, cxy = xz * yz - xy * f, cxz = xy * yz - xz * d;
    const float cyy = a * f - xz * xz, cyz = xy * xz - a * yz, czz = a * d - xy * xy;
    const float det = a * cxx + xy * cxy + xz * cxz;
    const float over = 1 / det;
    *y = {(cxx * rx + cxy * ry + cxz * rz) * over, (cxy * rx + cyy * ry + cyz * rz) * over,
          (cxz * rx + cyz * ry + czz * rz) * over};
    return det > 0;
  }
};

}  // namespace lodpipe
