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
  float weight;         // the area that it stands for
};

struct Hit {
  int32_t face = kNoFace;  // of the level
  float b1 = 0, b2 = 0;    // barycentric there
  float distance2 = 0;     // squared, to there
};

// A level that samples are carried to, by walking from face to face within charts.
class Target {
 public:
  static constexpr int kGrain = 2048;

  Target(const FitMesh& mesh, Pool& pool)
      : mesh_(mesh), pool_(pool), wedges_(mesh.wedges, mesh.face_count, mesh.wedge_count), beyond_(3 * static_cast<size_t>(mesh.face_count)),
        planes_(mesh.face_count) {
    pool_.range(mesh.face_count, kGrain, [&](int begin, int end) {
      for (int f = begin; f < end; ++f)
        for (int k = 0; k < 3; ++k) beyond_[3 * static_cast<size_t>(f) + k] = beyond(wedge(f, (k + 1) % 3), wedge(f, (k + 2) % 3));
    });
  }

  const Corners& wedges() const { return wedges_; }

  // Where the vertices are from now on; they must stay alive.
  void place(const std::vector<Vec3>& at) {
    at_ = at.data();
    pool_.range(mesh_.face_count, kGrain, [&](int begin, int end) {
      for (int f = begin; f < end; ++f) planes_[f] = plane(f);
    });
  }

  float doubled_area(int32_t f) const { return length(across(f)); }

  // The nearest face round three wedges of the level (−1: none), and on from there. `guess`: a face to begin with, or −1.
  Hit nearest(const Sample& s, const int32_t wedges[3], int32_t guess) const {
    Hit hit;
    if (guess != kNoFace && (has(guess, wedges[0]) || has(guess, wedges[1]) || has(guess, wedges[2])) && settle(s, guess, hit)) return hit;
    hit.distance2 = kInfinity;
    for (int k = 0; k < 3; ++k) {
      const int32_t w = wedges[k];
      if (w == kNoFace || is_hub(w) || (k > 0 && w == wedges[0]) || (k > 1 && w == wedges[1])) continue;
      for (int32_t i = wedges_.start[w]; i < wedges_.start[w + 1]; ++i) {
        const int32_t f = wedges_.list[i] / 3;
        if ((k > 0 && has(f, wedges[0])) || (k > 1 && has(f, wedges[1]))) continue;  // looked at
        look(s, f, hit);
      }
    }
    walk(s, hit);
    return hit;
  }

  // The same from the face where the sample was, if it had one.
  Hit again(const Sample& s, const Hit& before) const {
    if (before.face == kNoFace) return before;
    Hit hit;
    if (settle(s, before.face, hit)) return hit;
    hit.distance2 = kInfinity;
    look(s, before.face, hit);
    if (hit.face == kNoFace) return nearest(s, mesh_.wedges + 3 * static_cast<int64_t>(before.face), kNoFace);
    walk(s, hit);
    return hit;
  }

 private:
  static constexpr int kHops = 8;         // from face to nearer face
  static constexpr int kSteps = 8;        // over edges
  static constexpr float kEdge = 0.001f;  // barycentric weight from which on a place is off the edge opposite
  static constexpr int kHub = 512;        // faces round a wedge from which on samples come by its neighbours only

  // What tells quickly where above a face a point lies.
  struct Plane {
    Vec3 origin, first, second, normal;  // a corner; what gives the other two's weights; of unit length
    float height[3];                     // of each corner above the edge opposite
  };

  int32_t wedge(int32_t f, int k) const { return mesh_.wedges[3 * static_cast<int64_t>(f) + k]; }
  bool is_hub(int32_t w) const { return wedges_.start[w + 1] - wedges_.start[w] > kHub; }
  bool has(int32_t f, int32_t w) const { return wedge(f, 0) == w || wedge(f, 1) == w || wedge(f, 2) == w; }

  // The face that has the edge the other way round, with the same wedges.
  int32_t beyond(int32_t from, int32_t to) const {
    const int32_t w = wedges_.start[from + 1] - wedges_.start[from] < wedges_.start[to + 1] - wedges_.start[to] ? from : to;
    if (is_hub(w)) return kNoFace;
    for (int32_t i = wedges_.start[w]; i < wedges_.start[w + 1]; ++i) {
      const int32_t f = wedges_.list[i] / 3;
      const int k = wedges_.list[i] % 3;
      if (w == to ? wedge(f, (k + 1) % 3) == from : wedge(f, (k + 2) % 3) == to) return f;
    }
    return kNoFace;
  }

  Vec3 corner(int32_t f, int k) const { return at_[mesh_.faces[3 * static_cast<int64_t>(f) + k]]; }
  Vec3 across(int32_t f) const { return cross(corner(f, 1) - corner(f, 0), corner(f, 2) - corner(f, 0)); }

  Plane plane(int32_t f) const {
    const Vec3 a = corner(f, 0), ab = corner(f, 1) - a, ac = corner(f, 2) - a, n = cross(ab, ac);
    const float doubled2 = dot(n, n);
    if (!(doubled2 > 0)) return {a, {}, {}, {}, {0, 0, 0}};
    const float over = 1 / doubled2, doubled = std::sqrt(doubled2);
    const auto height = [&](Vec3 edge) { return doubled / std::max(length(edge), 1e-30f); };
    return {a, cross(ac, n) * over, cross(n, ab) * over, n * (1 / doubled), {height(ac - ab), height(ac), height(ab)}};
  }

  // From a face over edges to the one that the sample lies above or below, nearer to it than to its edges: neighbours
  // then are nearer only if they fold back. False where that does not lead anywhere.
  bool settle(const Sample& s, int32_t f, Hit& hit) const {
    int32_t before = kNoFace;
    for (int step = 0; step < kSteps && f != kNoFace; ++step) {
      const Plane& p = planes_[f];
      if (!(dot(p.normal, s.normal) > 0)) return false;
      const Vec3 to = s.at - p.origin;
      const float b1 = dot(p.first, to), b2 = dot(p.second, to), d = dot(p.normal, to), far = std::abs(d);
      const float room[3] = {(1 - b1 - b2) * p.height[0], b1 * p.height[1], b2 * p.height[2]};  // to the edges
      const int k = room[0] < room[1] ? (room[0] < room[2] ? 0 : 2) : (room[1] < room[2] ? 1 : 2);
      if (room[k] > far) {
        hit = {f, b1, b2, d * d};
        return true;
      }
      const int32_t next = beyond_[3 * static_cast<size_t>(f) + k];
      if (room[k] >= 0) {  // above the face, near one edge: the two faces there
        if (next == kNoFace || room[(k + 1) % 3] <= far || room[(k + 2) % 3] <= far) return false;
        hit = {f, b1, b2, d * d};
        look(s, next, hit);
        return true;
      }
      if (next == before) return false;  // beyond the edge for both of its faces
      before = f, f = next;
    }
    return false;
  }

  // Takes the face if it is nearer and looks the same way.
  void look(const Sample& s, int32_t f, Hit& best) const {
    const Plane& p = planes_[f];
    if (!(dot(p.normal, s.normal) > 0)) return;
    const float d = dot(p.normal, s.at - p.origin);
    if (d * d >= best.distance2) return;
    const Hit found = closest(s.at, f, corner(f, 0), corner(f, 1), corner(f, 2));
    if (found.distance2 < best.distance2) best = found;
  }

  void walk(const Sample& s, Hit& hit) const {
    for (int hop = 0; hop < kHops && hit.face != kNoFace; ++hop) {
      const int32_t from = hit.face;
      // round the corners that the closest point lies near
      const float weight[3] = {1 - hit.b1 - hit.b2, hit.b1, hit.b2};
      const Plane& p = planes_[from];
      if (hit.distance2 < squared(weight[0] * p.height[0]) && hit.distance2 < squared(weight[1] * p.height[1]) &&
          hit.distance2 < squared(weight[2] * p.height[2]))
        return;
      for (int k = 0; k < 3; ++k) {
        if (weight[k] <= kEdge || is_hub(wedge(from, k))) continue;
        const int32_t w = wedge(from, k);
        for (int32_t i = wedges_.start[w]; i < wedges_.start[w + 1]; ++i)
          if (const int32_t f = wedges_.list[i] / 3; f != from) look(s, f, hit);
      }
      if (hit.face == from) return;
    }
  }

  static float squared(float x) { return x * x; }

  // Closest point of a triangle (Ericson 2004, section 5.1.5).
  static Hit closest(Vec3 p, int32_t face, Vec3 a, Vec3 b, Vec3 c) {
    const Vec3 ab = b - a, ac = c - a, ap = p - a;
    const auto at = [&](float s, float t) {
      const Vec3 d = ap - ab * s - ac * t;
      return Hit{face, s, t, dot(d, d)};
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

  const FitMesh& mesh_;
  Pool& pool_;
  const Vec3* at_ = nullptr;
  Corners wedges_;
  std::vector<int32_t> beyond_;  // for each corner the face over the edge opposite
  Large<Plane> planes_;
};

}  // namespace lodpipe
