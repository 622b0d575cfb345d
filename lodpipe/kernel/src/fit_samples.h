// Samples of the original, and where on the level each of them belongs.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "fit.h"
#include "least_squares.h"

namespace lodpipe {

constexpr int32_t kNoFace = -1;

struct Sample {
  Vec3 at, normal;      // place and unit normal of the original, in a box of unit diagonal
  int32_t source;       // face of the original
  float a1, a2;         // barycentric there
};

struct Hit {
  int32_t face = kNoFace;  // of the level
  float b1 = 0, b2 = 0;    // barycentric there
  float distance2 = 0;     // squared, to there
};

// A level that samples are carried to, by walking from face to face within charts.
class Target {
 public:
  Target(const FitMesh& mesh, Pool& pool) : mesh_(mesh), pool_(pool), wedges_(mesh.wedges, mesh.face_count, mesh.wedge_count) {
    triangles_.resize(mesh.face_count);
  }

  const Corners& wedges() const { return wedges_; }
  // The cross product of two edges: its length is twice the face's area.
  Vec3 across(int32_t f) const { return triangles_[f].across; }

  void place(const std::vector<Vec3>& at) {
    pool_.range(mesh_.face_count, kGrain, [&](int begin, int end) {
      for (int f = begin; f < end; ++f) {
        const int32_t* v = mesh_.faces + 3 * static_cast<int64_t>(f);
        const Vec3 a = at[v[0]], b = at[v[1]], c = at[v[2]];
        const Vec3 middle = (a + b + c) * (1.0f / 3);
        const auto from = [&](Vec3 corner) { return dot(corner - middle, corner - middle); };
        triangles_[f] = {a, b, c, cross(b - a, c - a), middle, std::sqrt(std::max({from(a), from(b), from(c)}))};
      }
    });
  }

  // The nearest face round three wedges of the level (−1: none), and on from there. `guess`: a face to begin with, or −1.
  Hit nearest(const Sample& s, const int32_t wedges[3], int32_t guess) const {
    Hit hit;
    hit.distance2 = kInfinity;
    if (guess != kNoFace && (has(guess, wedges[0]) || has(guess, wedges[1]) || has(guess, wedges[2]))) {
      look(s, guess, hit);
      if (hit.face != kNoFace && is_settled(hit)) return hit;
    }
    for (int k = 0; k < 3; ++k) {
      const int32_t w = wedges[k];
      if (w == kNoFace || is_hub(w) || (k > 0 && w == wedges[0]) || (k > 1 && w == wedges[1])) continue;
      for (int32_t i = wedges_.start[w]; i < wedges_.start[w + 1]; ++i) {
        const int32_t f = wedges_.list[i] / 3;
        if ((k > 0 && has(f, wedges[0])) || (k > 1 && has(f, wedges[1]))) continue;  // looked at
        look(s, f, hit);
        if (hit.face == f && is_settled(hit)) return hit;
      }
    }
    walk(s, hit);
    return hit;
  }

  // The same from the face where the sample was.
  Hit again(const Sample& s, const Hit& before) const {
    Hit hit;
    hit.distance2 = kInfinity;
    look(s, before.face, hit);
    if (hit.face == kNoFace) return nearest(s, mesh_.wedges + 3 * static_cast<int64_t>(before.face), kNoFace);
    walk(s, hit);
    return hit;
  }

  static constexpr int kGrain = 2048;

 private:
  static constexpr int kHops = 8;            // from face to nearer face
  static constexpr float kEdge = 0.001f;     // barycentric weight from which on a place is off the edge opposite
  static constexpr int kHub = 512;           // faces round a wedge from which on samples come by its neighbours only

  struct Triangle {
    Vec3 a, b, c, across, middle;
    float radius;  // round the middle
  };

  bool is_hub(int32_t wedge) const { return wedges_.start[wedge + 1] - wedges_.start[wedge] > kHub; }
  bool has(int32_t f, int32_t wedge) const {
    const int32_t* w = mesh_.wedges + 3 * static_cast<int64_t>(f);
    return w[0] == wedge || w[1] == wedge || w[2] == wedge;
  }

  // Takes the face if it is nearer and looks the same way.
  void look(const Sample& s, int32_t f, Hit& best) const {
    const Triangle& t = triangles_[f];
    if (!(dot(t.across, s.normal) > 0)) return;
    // farther than the best so far, by the circle round it
    const Vec3 to = s.at - t.middle;
    const float away2 = dot(to, to), r2 = t.radius * t.radius;
    if (const float gap = away2 - best.distance2 - r2; gap > 0 && gap * gap > 4 * best.distance2 * r2) return;
    const Hit found = closest(s.at, t, f);
    if (found.distance2 < best.distance2) best = found;
  }

  // Whether the sample is nearer to the face than to its edges: a neighbour is nearer only if it folds back.
  bool is_settled(const Hit& hit) const {
    const Triangle& t = triangles_[hit.face];
    const float area = dot(t.across, t.across);
    const auto nearer = [&](Vec3 edge, float weight) { return hit.distance2 * dot(edge, edge) < weight * weight * area; };
    return nearer(t.c - t.b, 1 - hit.b1 - hit.b2) && nearer(t.c - t.a, hit.b1) && nearer(t.b - t.a, hit.b2);
  }

  void walk(const Sample& s, Hit& hit) const {
    for (int hop = 0; hop < kHops && hit.face != kNoFace; ++hop) {
      if (is_settled(hit)) return;
      const int32_t from = hit.face;
      // round the corners that the closest point lies near
      const float weight[3] = {1 - hit.b1 - hit.b2, hit.b1, hit.b2};
      for (int k = 0; k < 3; ++k) {
        if (weight[k] <= kEdge) continue;
        const int32_t w = mesh_.wedges[3 * static_cast<int64_t>(from) + k];
        if (is_hub(w)) continue;
        for (int32_t i = wedges_.start[w]; i < wedges_.start[w + 1]; ++i)
          if (const int32_t f = wedges_.list[i] / 3; f != from) look(s, f, hit);
      }
      if (hit.face == from) return;
    }
  }

  // Closest point of a triangle (Ericson 2004, section 5.1.5).
  static Hit closest(Vec3 p, const Triangle& t, int32_t face) {
    const Vec3 ab = t.b - t.a, ac = t.c - t.a, ap = p - t.a;
    const auto at = [&](float s, float r) {
      const Vec3 d = ap - ab * s - ac * r;
      return Hit{face, s, r, dot(d, d)};
    };
    const float d1 = dot(ab, ap), d2 = dot(ac, ap);
    if (d1 <= 0 && d2 <= 0) return at(0, 0);
    const Vec3 bp = p - t.b;
    const float d3 = dot(ab, bp), d4 = dot(ac, bp);
    if (d3 >= 0 && d4 <= d3) return at(1, 0);
    const float vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0) return at(d1 / (d1 - d3), 0);
    const Vec3 cp = p - t.c;
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

  const FitMesh& mesh_;
  Pool& pool_;
  Corners wedges_;
  Large<Triangle> triangles_;
};

}  // namespace lodpipe
