// What lies round the two ends of an edge, and what of it forbids to collapse the edge.
#pragma once
#include <algorithm>
#include <cmath>

#include "mesh_state.h"

namespace lodpipe {

constexpr float kLeastQuality = 1e-3f;  // 2·area / longest edge², below which a new face is a sliver

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
    const Lanes qx{q[0]->x, q[1]->x, q[2]->x, q[3]->x}, qy{q[0]->y, q[1]->y, q[2]->y, q[3]->y},
        qz{q[0]->z, q[1]->z, q[2]->z, q[3]->z};
    const Lanes rx{r[0]->x, r[1]->x, r[2]->x, r[3]->x}, ry{r[0]->y, r[1]->y, r[2]->y, r[3]->y},
        rz{r[0]->z, r[1]->z, r[2]->z, r[3]->z};
    const Lanes ex = rx - qx, ey = ry - qy, ez = rz - qz;
    const Lanes ox = p.x - qx, oy = p.y - qy, oz = p.z - qz, nx = x.x - qx, ny = x.y - qy, nz = x.z - qz;
    const Lanes ax = ey * oz - ez * oy, ay = ez * ox - ex * oz, az = ex * oy - ey * ox;
    const Lanes bx = ey * nz - ez * ny, by = ez * nx - ex * nz, bz = ex * ny - ey * nx;
    const Lanes before = ax * ax + ay * ay + az * az, after = bx * bx + by * by + bz * bz;
    const Lanes cosine = ax * bx + ay * by + az * bz;
    const Lanes tx = x.x - rx, ty = x.y - ry, tz = x.z - rz, sx = p.x - rx, sy = p.y - ry, sz = p.z - rz;
    const auto most = [](Lanes a, Lanes b) { return a > b ? a : b; };
    const Lanes base = ex * ex + ey * ey + ez * ez;
    const Lanes longest = most(most(base, nx * nx + ny * ny + nz * nz), tx * tx + ty * ty + tz * tz);
    const Lanes longest_before = most(most(base, ox * ox + oy * oy + oz * oz), sx * sx + sy * sy + sz * sz);
    const Lanes size = longest * longest, size_before = longest_before * longest_before;
    // a sliver, and it was none before; or over the limit of the turn
    const auto sliver = (after < kLeastQuality * kLeastQuality * size) & (after * size_before < 0.25f * before * size);
    const auto turned =
        (before > 1e-12f * size) & ((cosine <= 0) | (cosine * cosine < flip_cos * flip_cos * before * after));
    const auto bad = sliver | turned;
    return bad[0] | bad[1] | bad[2] | bad[3];
  }

  Buffer<Neighbour> near_v_, near_u_;
};

}  // namespace lodpipe
