// What lies round the two ends of an edge, and what of it forbids to collapse the edge.
#pragma once
#include <algorithm>
#include <cmath>

#include "mesh_state.h"

namespace lodpipe {

constexpr float kLeastQuality = 1e-3f;  // 2·area / longest edge², below which a new face is a sliver

struct FourPoints {
  Lanes x, y, z;
  // `p` point to positions with at least one more number behind them.
  static FourPoints of_rows(const void* const p[4]) {
    Lanes row[4];
    for (int k = 0; k < 4; ++k) std::memcpy(&row[k], p[k], sizeof(Lanes));
    transpose(row[0], row[1], row[2], row[3]);
    return {row[0], row[1], row[2]};
  }
  static FourPoints of(const Vec3* const p[4]) {
    return {Lanes{p[0]->x, p[1]->x, p[2]->x, p[3]->x}, Lanes{p[0]->y, p[1]->y, p[2]->y, p[3]->y},
            Lanes{p[0]->z, p[1]->z, p[2]->z, p[3]->z}};
  }
};
inline FourPoints operator-(const FourPoints& a, const FourPoints& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Lanes dot(const FourPoints& a, const FourPoints& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline FourPoints cross(const FourPoints& a, const FourPoints& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// Of four triangles, the corners before and after: bit k, if the k-th turned by more than the limit or became a sliver.
inline int four_bad(const FourPoints (&before)[3], const FourPoints (&after)[3], float flip_cos) {
  const auto most = [](Lanes a, Lanes b) { return a > b ? a : b; };
  const auto look = [&](const FourPoints (&p)[3], FourPoints* normal, Lanes* size) {
    const FourPoints base = p[2] - p[1], side = p[0] - p[1], other = p[0] - p[2];
    *normal = cross(base, side);
    const Lanes longest = most(most(dot(base, base), dot(side, side)), dot(other, other));
    *size = longest * longest;
  };
  FourPoints a, b;
  Lanes size_before, size;
  look(before, &a, &size_before);
  look(after, &b, &size);
  const Lanes area_before = dot(a, a), area = dot(b, b), cosine = dot(a, b);  // squared, twice as large
  const auto sliver = (area < kLeastQuality * kLeastQuality * size) & (area * size_before < 0.25f * area_before * size);
  const auto turned =
      (area_before > 1e-12f * size) & ((cosine <= 0) | (cosine * cosine < flip_cos * flip_cos * area_before * area));
  const auto bad = sliver | turned;
  return (bad[0] & 1) | (bad[1] & 2) | (bad[2] & 4) | (bad[3] & 8);
}

// A face as a vertex sees it: the vertex's corner in it, and the other two vertices in their order. Of a link one of
// the two is kNone.
struct Spoke {
  int32_t corner, next, previous;
  bool link() const { return (next | previous) < 0; }
};

class Around {
 public:
  Buffer<Spoke> of_v, of_u;  // without the faces on the edge
  Buffer<Spoke> between;     // those, from v
  int shared = 0;            // triangles among them

  void gather(const State& s, int32_t v, int32_t u) {
    // plain pointers: a buffer's size would go through memory at each step
    const auto room = static_cast<size_t>(s.vertices[v].count);
    Spoke *to_v = of_v.refill(room), *to_between = between.refill(room);
    int triangles = 0;
    each(s, v, [&](const Spoke& spoke) {
      if (spoke.next != u && spoke.previous != u) {
        *to_v++ = spoke;
      } else {
        *to_between++ = spoke;
        triangles += !spoke.link();
      }
    });
    Spoke* to_u = of_u.refill(static_cast<size_t>(s.vertices[u].count));
    each(s, u, [&](const Spoke& spoke) {
      if (spoke.next != v && spoke.previous != v) *to_u++ = spoke;
    });
    of_v.end_at(to_v), between.end_at(to_between), of_u.end_at(to_u);
    shared = triangles;
  }

  // Calls body(spoke) for the live faces and links of v.
  template <class Body>
  static void each(const State& s, int32_t v, const Body& body) {
    const int32_t* const end = s.corners.end(s.vertices[v]);
    for (const int32_t* c = s.corners.begin(s.vertices[v]); c != end; ++c) {
      const Face& f = s.faces[face_of(*c)];
      const int next = kNext[slot_of(*c)];
      if (!f.dead()) body(Spoke{*c, f.v[next], f.v[kNext[next]]});
    }
  }

  // The vertex of a triangle on the edge that is neither v nor u.
  static int32_t opposite(const Spoke& between, int32_t u) { return between.next == u ? between.previous : between.next; }

  bool inside(int32_t begin, int32_t end) const {
    for (const Buffer<Spoke>* ring : {&of_v, &of_u, &between})
      for (const Spoke& spoke : *ring)
        for (const int32_t n : {spoke.next, spoke.previous})
          if (n != kNone && (n < begin || n >= end)) return false;
    return true;
  }

  // The vertices adjacent to both ends are just those opposite to the edge in its faces (Dey et al. 1999), and two
  // boundaries are not pinched together.
  bool link_condition(int32_t v, int32_t u) {
    neighbours(of_v, v, u, &near_v_);
    neighbours(of_u, u, v, &near_u_);
    size_t common = 0, opposites = 0;
    for (size_t i = 0, j = 0; i < near_v_.size() && j < near_u_.size();) {
      if (near_v_[i].vertex == near_u_[j].vertex) ++common, ++i, ++j;
      else if (near_v_[i].vertex < near_u_[j].vertex) ++i;
      else ++j;
    }
    for (size_t i = 0; i < between.size(); ++i) {
      if (between[i].link()) continue;
      const auto same = [&](const Spoke& b) { return !b.link() && opposite(b, u) == opposite(between[i], u); };
      opposites += std::none_of(between.begin(), between.begin() + i, same);
    }
    if (common != opposites) return false;
    if (shared == 1) return true;
    const auto on_boundary = [](const Buffer<Neighbour>& near) {
      return std::any_of(near.begin(), near.end(), [](const Neighbour& n) { return n.faces == 1; });
    };
    return !(on_boundary(near_v_) && on_boundary(near_u_));
  }

  // Would a locked vertex lose its last face?
  bool strands_locked(const State& s, int32_t v, int32_t u) const {
    const auto triangle = [](const Spoke& spoke) { return !spoke.link(); };
    if ((s.flags[v] | s.flags[u]) & kLocked && std::none_of(of_v.begin(), of_v.end(), triangle) &&
        std::none_of(of_u.begin(), of_u.end(), triangle))
      return true;
    for (const Spoke& b : between) {
      if (b.link() || !(s.flags[opposite(b, u)] & kLocked)) continue;
      bool keeps = false;
      each(s, opposite(b, u), [&](const Spoke& spoke) {
        const bool goes = (spoke.next == v || spoke.previous == v) && (spoke.next == u || spoke.previous == u);
        keeps |= !goes && !spoke.link();
      });
      if (!keeps) return true;
    }
    return false;
  }

  // Would a face turn over, or become a sliver, when v and u go to x?
  bool turns(const State& s, int32_t v, int32_t u, Vec3 x, float flip_cos) const {
    return turns(s, of_v, s.vertices[v].p, x, flip_cos) || turns(s, of_u, s.vertices[u].p, x, flip_cos);
  }

  void swap() { std::swap(of_v, of_u); }

 private:
  struct Neighbour {
    int32_t vertex;
    int32_t faces;  // triangles on the edge to it
  };

  // Neighbours of `end` along edges (links do not hold a surface together), ascending.
  void neighbours(const Buffer<Spoke>& ring, int32_t end, int32_t other, Buffer<Neighbour>* near) const {
    near->clear();
    const auto add = [&](int32_t n) {
      if (n != end) near->push_back({n, 1});
    };
    for (const Spoke& spoke : ring)
      if (!spoke.link()) add(spoke.next), add(spoke.previous);
    for (const Spoke& b : between)
      if (!b.link()) add(b.next == end ? other : b.next), add(b.previous == end ? other : b.previous);
    std::sort(near->begin(), near->end(), [](const Neighbour& a, const Neighbour& b) { return a.vertex < b.vertex; });
    size_t kept = 0;
    for (const Neighbour& n : *near)
      if (kept && (*near)[kept - 1].vertex == n.vertex) (*near)[kept - 1].faces += n.faces;
      else (*near)[kept++] = n;
    near->resize(kept);
  }

  static bool turns(const State& s, const Buffer<Spoke>& ring, Vec3 p, Vec3 x, float flip_cos) {
    const Vec3* q[4];
    const Vec3* r[4];
    int count = 0;
    for (size_t i = 0; i < ring.size(); ++i) {
      if (!ring[i].link()) {
        q[count] = &s.vertices[ring[i].next].p, r[count] = &s.vertices[ring[i].previous].p;
        ++count;
      }
      if (count == 4 || (i + 1 == ring.size() && count)) {
        for (int k = count; k < 4; ++k) q[k] = q[0], r[k] = r[0];
        if (four_turn(p, x, q, r, flip_cos)) return true;
        count = 0;
      }
    }
    return false;
  }

  // The same for the triangles (p → x, q, r) in the lanes of a vector.
  static bool four_turn(Vec3 p, Vec3 x, const Vec3* const* q, const Vec3* const* r, float flip_cos) {
    const FourPoints second = FourPoints::of(q), third = FourPoints::of(r);
    const FourPoints before[3] = {{Lanes{} + p.x, Lanes{} + p.y, Lanes{} + p.z}, second, third};
    const FourPoints after[3] = {{Lanes{} + x.x, Lanes{} + x.y, Lanes{} + x.z}, second, third};
    return four_bad(before, after, flip_cos);
  }

  Buffer<Neighbour> near_v_, near_u_;
};

}  // namespace lodpipe
