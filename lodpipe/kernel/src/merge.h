// What becomes of two vertices that are merged: cost, place, attributes and quadric.
#pragma once
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "around.h"
#include "chart.h"
#include "mesh_state.h"
#include "wedges.h"

namespace lodpipe {

constexpr float kDamping = 3e-6f;    // share of the trace that pulls the optimum to the middle where nothing else does
constexpr float kShortEdge = 1e-9f;  // among equals the shorter edge goes first
constexpr float kReach = 2.0f;       // the optimum lies within so many edge lengths of the edge's middle

// Four vertices in the lanes of vectors.
struct FourVertices {
  Lanes x, y, z, xx, xy, xz, yy, yz, zz, bx, by, bz, c;

  static FourVertices of(const Vertex* const v[4]) {
    Lanes row[3][4];  // the first twelve numbers of each, four at a time
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 4; ++k) std::memcpy(&row[i][k], reinterpret_cast<const char*>(v[k]) + 16 * i, 16);
      transpose(row[i][0], row[i][1], row[i][2], row[i][3]);
    }
    return {row[0][0], row[0][1], row[0][2], row[0][3], row[1][0], row[1][1], row[1][2], row[1][3],
            row[2][0], row[2][1], row[2][2], row[2][3], Lanes{v[0]->q.c, v[1]->q.c, v[2]->q.c, v[3]->q.c}};
  }
};

class Merge {
 public:
  Quadric quadric;       // after commit(): of the merged vertex, at its place
  float deviation = 0;   // after place(): root mean square distance to what was merged, unit box
  bool moved = false;    // after commit(): the vertex is at a place where no input vertex was
  bool locked = false;   // after place(): a lock forbids it
  int32_t kept = kNone;  // after place(): the vertex that stays

  // Costs of merging v with each of `others`: the same as place(), four at a time where nothing but planes steers.
  void costs(const State& s, const Options& options, int32_t v, const Buffer<int32_t>& others, float* out) {
    const Vertex& a = s.vertices[v];
    const size_t count = others.size();
    if (options.placement != Placement::optimal || s.steering || (s.flags[v] & kLocked)) {
      for (size_t i = 0; i < count; ++i) out[i] = cost(s, options, v, others[i]);
      return;
    }
    const Vertex* const same[4] = {&a, &a, &a, &a};
    const FourVertices first = FourVertices::of(same);
    for (size_t i = 0; i < count; i += 4) {
      const Vertex* b[4];
      for (size_t k = 0; k < 4; ++k) b[k] = &s.vertices[others[std::min(i + k, count - 1)]];
      Lanes four;
      FourPoints unused;
      const int sound = four_places(first, FourVertices::of(b), &four, &unused);
      for (size_t k = 0; k < 4 && i + k < count; ++k)
        out[i + k] = sound >> k & 1 && !(s.flags[others[i + k]] & kLocked) ? four[k] : cost(s, options, v, others[i + k]);
    }
  }

  float cost(const State& s, const Options& options, int32_t v, int32_t u) {
    Vec3 y;
    return place(s, options, v, u, &y);
  }

  // Cost of merging v and u, at kept + *y. Infinite if it is not possible.
  float place(const State& s, const Options& options, int32_t v, int32_t u, Vec3* y) {
    const Vertex &a = s.vertices[v], &b = s.vertices[u];
    *y = {};
    const uint8_t of_v = s.flags[v], of_u = s.flags[u];
    locked = of_v & of_u & kLocked;
    if (locked) return kInfinity;
    if (options.placement == Placement::endpoint || ((of_v | of_u) & kLocked)) {
      const float onto_v = of_u & kLocked ? kInfinity : onto(s, v, u);
      const float trace_v = quadric.trace();
      const float onto_u = of_v & kLocked ? kInfinity : onto(s, u, v);
      kept = onto_v <= onto_u ? v : u;
      if (kept == v) {
        if (onto_u < kInfinity) onto(s, v, u);  // its groups again
        return finish(onto_v, trace_v, b.p - a.p);
      }
      return finish(onto_u, quadric.trace(), b.p - a.p);
    }
    kept = v;
    fixed_ = false;
    if (s.steering) groups_.find(s, v, u);
    join(s, v, u, s.steering);
    const Vec3 d = b.p - a.p;
    const float trace = quadric.trace();
    Quadric least = quadric;  // with each attribute at its best value for the place
    for (size_t g = 0; s.steering && g < groups_.size(); ++g)
      for (int k = 0; k < s.steering && weights_[g] > 0; ++k) {
        const Slope& t = slopes_[g * s.steering + k];
        least.add_plane({t.x, t.y, t.z}, t.d, -1 / weights_[g]);
      }
    if (options.placement == Placement::midpoint) {
      *y = d * 0.5f;
    } else {
      const Vec3 middle = d * 0.5f;
      const bool solved = least.minimise(kDamping * trace, middle, y);
      const Vec3 away = *y - middle;
      if (!solved || !(dot(away, away) <= kReach * kReach * dot(d, d))) {
        // best point of the segment; its ends where the quadric is flat along it
        const Vec3 ad = least.times(d);
        const float along = least.bx * d.x + least.by * d.y + least.bz * d.z, curve = dot(ad, d);
        *y = d * (curve > 1e-12f * trace * dot(d, d) ? std::clamp(-along / curve, 0.0f, 1.0f) : 0.5f);
      }
    }
    return finish(std::max(least.at(*y), 0.0f), trace, d);
  }

  // place() for four pairs in the lanes of vectors, where nothing but planes steers; bit k of the result: lane k needs no
  // fall-back. `place` counts from a.
  static int four_places(const FourVertices& a, const FourVertices& b, Lanes* cost, FourPoints* place) {
    const Lanes dx = b.x - a.x, dy = b.y - a.y, dz = b.z - a.z;
    const Lanes ax = b.xx * dx + b.xy * dy + b.xz * dz, ay = b.xy * dx + b.yy * dy + b.yz * dz,
                az = b.xz * dx + b.yz * dy + b.zz * dz;
    const Lanes c = b.c - 2 * (b.bx * dx + b.by * dy + b.bz * dz) + (ax * dx + ay * dy + az * dz) + a.c;
    const Lanes bx = b.bx - ax + a.bx, by = b.by - ay + a.by, bz = b.bz - az + a.bz;
    const Lanes xx = b.xx + a.xx, xy = b.xy + a.xy, xz = b.xz + a.xz, yy = b.yy + a.yy, yz = b.yz + a.yz,
                zz = b.zz + a.zz;
    const Lanes trace = xx + yy + zz, damping = kDamping * trace;
    const Lanes mx = 0.5f * dx, my = 0.5f * dy, mz = 0.5f * dz;
    const Lanes p = xx + damping, q = yy + damping, r = zz + damping;
    const Lanes rx = damping * mx - bx, ry = damping * my - by, rz = damping * mz - bz;
    const Lanes cxx = q * r - yz * yz, cxy = xz * yz - xy * r, cxz = xy * yz - xz * q;
    const Lanes cyy = p * r - xz * xz, cyz = xy * xz - p * yz, czz = p * q - xy * xy;
    const Lanes det = p * cxx + xy * cxy + xz * cxz, over = 1 / det;
    const Lanes x = (cxx * rx + cxy * ry + cxz * rz) * over, y = (cxy * rx + cyy * ry + cyz * rz) * over,
                z = (cxz * rx + cyz * ry + czz * rz) * over;
    const Lanes wx = x - mx, wy = y - my, wz = z - mz;
    const Lanes edge = dx * dx + dy * dy + dz * dz;
    const auto sound = (det > 0) & (wx * wx + wy * wy + wz * wz <= kReach * kReach * edge);
    const Lanes e = (xx * x + xy * y + xz * z) * x + (xy * x + yy * y + yz * z) * y + (xz * x + yz * y + zz * z) * z +
                    2 * (bx * x + by * y + bz * z) + c;
    *cost = (e > 0 ? e : Lanes{}) + kShortEdge * trace * edge;
    *place = {x, y, z};
    return (sound[0] & 1) | (sound[1] & 2) | (sound[2] & 4) | (sound[3] & 8);
  }

  // Writes the merged attributes into `s` and fills `quadric`. Follows a place() of the same pair, and comes before the
  // faces are changed.
  void commit(State& s, int32_t v, int32_t u, Vec3 y, const Around& around) {
    const bool fixed = y.x == 0 && y.y == 0 && y.z == 0 && fixed_;
    moved = !fixed;
    if (!s.columns) {
      join(s, v, u, 0);
      quadric.move_origin(y);
      groups_.clear();
      return;
    }
    groups_.find(s, v, u);
    if (s.fitted) {
      fit(s, v, u, y, fixed, around);
    } else {  // half-edge collapses change no value, and those of `late` come later
      join(s, v, u, 0);
      quadric.move_origin(y);
    }
    groups_.link_up(!fixed);
  }

  // After commit(): what became of the wedges.
  const WedgeGroups& groups() const { return groups_; }

 private:
  float finish(float cost, float trace, Vec3 edge) {
    deviation = trace > 0 ? std::sqrt(cost / trace) : 0;
    return cost + kShortEdge * trace * dot(edge, edge);
  }

  // Cost of putting `gone` onto `stays`, attributes included. Infinite if a wedge of `gone` has no counterpart, or more
  // than one.
  float onto(const State& s, int32_t stays, int32_t gone) {
    fixed_ = true;
    if (s.columns) groups_.find(s, stays, gone);
    join(s, stays, gone, s.steering);
    for (size_t g = 0; s.columns && g < groups_.size(); ++g)
      if (groups_[g].of_v != 1) return kInfinity;
    return std::max(quadric.c, 0.0f);
  }

  // The values that fit best what was merged (Hoppe 1999): the fit's offset at the new place, over the weight.
  void fit(State& s, int32_t v, int32_t u, Vec3 y, bool fixed, const Around& around) {
    const auto columns = static_cast<size_t>(s.columns);
    join(s, v, u, s.columns);
    quadric.move_origin(y);
    steps_.resize(groups_.size() * columns);
    for (size_t g = 0; g < groups_.size(); ++g)
      for (size_t k = 0; k < columns; ++k) {
        Slope& t = slopes_[g * columns + k];
        t.d = t.at(y);
        steps_[g * columns + k] = !fixed && weights_[g] > 0 ? t.d / weights_[g] : 0.0f;
      }
    if (!fixed && s.chart_column >= 0 && groups_.size() > 1) chart_.run(s, groups_, around, steps_.data());
    for (size_t g = 0; g < groups_.size(); ++g) {
      const int32_t wedge = groups_[g].wedge;
      Slope* slopes = s.slopes(wedge);
      float* values = s.values(wedge);
      for (size_t k = 0; k < columns; ++k) {
        Slope& t = slopes_[g * columns + k];
        const float step = steps_[g * columns + k];
        if (k < static_cast<size_t>(s.steering)) shift(t, step, weights_[g]);
        t.d -= step * weights_[g];
        values[k] += step;
        slopes[k] = t;
      }
      s.weight(wedge) = weights_[g];
      if (!fixed) s.wedge_moved[wedge] = 1;
    }
  }

  // Sums of the quadrics of v and u, and of the first `columns` slopes of each group, with origin v and with the values
  // of the group's wedge.
  void join(const State& s, int32_t v, int32_t u, int columns) {
    const Vertex &a = s.vertices[v], &b = s.vertices[u];
    const Vec3 t = a.p - b.p;
    quadric = b.q;
    quadric.move_origin(t);
    quadric += a.q;
    if (!columns) return;
    slopes_.resize(groups_.size() * static_cast<size_t>(columns));
    weights_.resize(groups_.size());
    std::fill(slopes_.begin(), slopes_.end(), Slope{});
    std::fill(weights_.begin(), weights_.end(), 0.0f);
    for (const WedgeGroups::Member& member : groups_.members()) {
      const int32_t wedge = member.wedge, kept_wedge = groups_[member.group].wedge;
      const float w = s.weight(wedge);
      weights_[member.group] += w;
      const float *here = s.values(wedge), *there = s.values(kept_wedge);
      const Slope* from = s.slopes(wedge);
      for (int k = 0; k < columns; ++k) {
        Slope m = from[k];
        if (member.of_u) m.d = m.at(t);
        if (wedge != kept_wedge) {
          const float step = there[k] - here[k];
          if (k < s.steering) shift(m, step, w);
          m.d -= step * w;
        }
        slopes_[static_cast<size_t>(member.group) * columns + k] += m;
      }
    }
  }

  // The quadric's terms when an attribute is counted from a value `step` higher.
  void shift(const Slope& m, float step, float weight) {
    quadric.bx -= step * m.x, quadric.by -= step * m.y, quadric.bz -= step * m.z;
    quadric.c -= step * (2 * m.d - step * weight);
  }

  WedgeGroups groups_;
  Buffer<Slope> slopes_;   // groups × columns
  Buffer<float> weights_;  // of the groups
  Buffer<float> steps_;    // groups × columns: from the kept wedges' values to the new ones
  ChartKeeper chart_;
  bool fixed_ = false;
};

}  // namespace lodpipe
