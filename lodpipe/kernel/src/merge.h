// What becomes of two vertices that are merged: cost, place, attributes and quadric.
#pragma once
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "mesh_state.h"

namespace lodpipe {

constexpr float kDamping = 3e-6f;    // share of the trace that pulls the optimum to the middle where nothing else does
constexpr float kShortEdge = 1e-9f;  // among equals the shorter edge goes first
constexpr float kGutter = 4.0f / 1024;  // UV units beyond a chart's border that textures are expected to be padded by
constexpr float kReach = 2.0f;       // the optimum lies within so many edge lengths of the edge's middle

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
    for (size_t i = 0; i < count; i += 4) {
      const Vertex* b[4];
      for (size_t k = 0; k < 4; ++k) b[k] = &s.vertices[others[std::min(i + k, count - 1)]];
      Lanes four;
      const int sound = plane_costs(a, b, &four);
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
    join(s, v, u, s.steering);
    const Vec3 d = b.p - a.p;
    const float trace = quadric.trace();
    Quadric least = quadric;  // with each attribute at its best value for the place
    for (const Group& g : groups_)
      for (int k = 0; k < s.steering && g.weight > 0; ++k) {
        const Slope& t = slopes_[g.first + k];
        least.add_plane({t.x, t.y, t.z}, t.d, -1 / g.weight);
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

  // Writes the merged attributes into `s` and fills `quadric`. Follows a place() of the same pair.
  void commit(State& s, int32_t v, int32_t u, Vec3 y) {
    const bool fixed = y.x == 0 && y.y == 0 && y.z == 0 && fixed_;
    moved = !fixed;
    join(s, v, u, s.columns);
    quadric.move_origin(y);
    links_.clear();
    for (size_t number = 0; number < groups_.size(); ++number) {
      const Group& g = groups_[number];
      bool several = false;
      float* value = &s.value[static_cast<size_t>(g.wedge) * s.columns];
      steps_.assign(static_cast<size_t>(s.columns), 0.0f);
      for (int k = 0; k < s.columns; ++k) {
        Slope& t = slopes_[g.first + k];
        t.d = t.at(y);
        if (!fixed && g.weight > 0) steps_[k] = t.d / g.weight;
      }
      if (!fixed && s.chart_column >= 0 && groups_.size() > 1)
        keep_in_chart(s, v, u, static_cast<int32_t>(number), value + s.chart_column, &steps_[s.chart_column]);
      for (int k = 0; k < s.columns; ++k) {
        Slope& t = slopes_[g.first + k];
        if (k < s.steering) shift(t, steps_[k], g.weight);
        t.d -= steps_[k] * g.weight;
        value[k] += steps_[k];
        s.slope[static_cast<size_t>(g.wedge) * s.columns + k] = t;
      }
      s.weight[g.wedge] = g.weight;
      for (const auto& [wedge, group] : members_)
        if (group == static_cast<int32_t>(number) && wedge != g.wedge) links_.push_back({wedge, g.wedge}), several = true;
      if (!fixed) s.wedge_moved[g.wedge] = 1;
      if (!fixed && !several) links_.push_back({g.wedge, g.wedge});
    }
  }

  // The wedge that stands for `wedge` after commit().
  int32_t target(int32_t wedge) const {
    for (const auto& [w, group] : members_)
      if (w == wedge) return groups_[group].wedge;
    return wedge;
  }
  int groups() const { return static_cast<int>(groups_.size()); }
  const std::vector<std::pair<int32_t, int32_t>>& links() const { return links_; }
  void reset() { members_.clear(), groups_.clear(), links_.clear(); }

 private:
  // place() for four neighbours in the lanes of a vector; bit k of the result: lane k needs no fall-back.
  static int plane_costs(const Vertex& a, const Vertex* const b[4], Lanes* cost) {
    const auto pick = [&](auto field) { return Lanes{field(*b[0]), field(*b[1]), field(*b[2]), field(*b[3])}; };
    const Lanes dx = pick([](const Vertex& v) { return v.p.x; }) - a.p.x;
    const Lanes dy = pick([](const Vertex& v) { return v.p.y; }) - a.p.y;
    const Lanes dz = pick([](const Vertex& v) { return v.p.z; }) - a.p.z;
    Lanes xx = pick([](const Vertex& v) { return v.q.xx; }), xy = pick([](const Vertex& v) { return v.q.xy; });
    Lanes xz = pick([](const Vertex& v) { return v.q.xz; }), yy = pick([](const Vertex& v) { return v.q.yy; });
    Lanes yz = pick([](const Vertex& v) { return v.q.yz; }), zz = pick([](const Vertex& v) { return v.q.zz; });
    Lanes bx = pick([](const Vertex& v) { return v.q.bx; }), by = pick([](const Vertex& v) { return v.q.by; });
    Lanes bz = pick([](const Vertex& v) { return v.q.bz; }), c = pick([](const Vertex& v) { return v.q.c; });
    const Lanes ax = xx * dx + xy * dy + xz * dz, ay = xy * dx + yy * dy + yz * dz, az = xz * dx + yz * dy + zz * dz;
    c = c - 2 * (bx * dx + by * dy + bz * dz) + (ax * dx + ay * dy + az * dz) + a.q.c;
    bx = bx - ax + a.q.bx, by = by - ay + a.q.by, bz = bz - az + a.q.bz;
    xx += a.q.xx, xy += a.q.xy, xz += a.q.xz, yy += a.q.yy, yz += a.q.yz, zz += a.q.zz;
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
    return (sound[0] & 1) | (sound[1] & 2) | (sound[2] & 4) | (sound[3] & 8);
  }

  struct Group {
    int32_t wedge;  // the one that stays
    int first;      // row of slopes_
    float weight;
  };

  float finish(float cost, float trace, Vec3 edge) {
    deviation = trace > 0 ? std::sqrt(cost / trace) : 0;
    return cost + kShortEdge * trace * dot(edge, edge);
  }

  // Cost of putting `gone` onto `stays`, attributes included. Infinite if a wedge of `gone` has no counterpart, or more
  // than one.
  float onto(const State& s, int32_t stays, int32_t gone) {
    fixed_ = true;
    join(s, stays, gone, s.steering);
    for (const auto& [wedge, group] : members_)
      if (own_[group] != 1) return kInfinity;
    return std::max(quadric.c, 0.0f);
  }

  // At a seam the best fit may lie outside the chart, where the texture shows something else: then the point that is
  // nearest to the faces which the group has round v and u takes its place, but for the width of a gutter. `value` and `step` are the two UV columns.
  void keep_in_chart(const State& s, int32_t v, int32_t u, int32_t group, const float* value, float* step) const {
    const Point wanted{value[0] + step[0], value[1] + step[1]};
    Point best = wanted;
    float nearest = kInfinity;
    for (const int32_t end : {v, u})
      for (int32_t c = s.vertices[end].head; c != kNone; c = s.faces[face_of(c)].next[slot_of(c)]) {
        const Face& f = s.faces[face_of(c)];
        if (f.dead() || f.link()) continue;
        const int32_t* w = s.wedges[face_of(c)].w;
        const auto member = std::find_if(members_.begin(), members_.end(),
                                         [&](const auto& m) { return m.first == w[slot_of(c)]; });
        if (member == members_.end() || member->second != group) continue;
        Point corner[3];
        for (int k = 0; k < 3; ++k) {
          const float* at = &s.value[static_cast<size_t>(w[k]) * s.columns + s.chart_column];
          corner[k] = {at[0], at[1]};
        }
        const Point found = nearest_in_triangle(wanted, corner);
        const float away = squared(found, wanted);
        if (away < nearest) nearest = away, best = found;
      }
    const float gutter = kGutter * s.column_scale[s.chart_column];  // values that steer are scaled
    const float part = nearest > 0 ? std::min(1.0f, gutter / std::sqrt(nearest)) : 0.0f;
    step[0] = best.x + part * (wanted.x - best.x) - value[0];
    step[1] = best.y + part * (wanted.y - best.y) - value[1];
  }

  struct Point {
    float x, y;
  };
  static float squared(Point a, Point b) { return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y); }
  static Point nearest_in_triangle(Point p, const Point* t) {
    const auto side = [](Point a, Point b, Point c) { return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x); };
    const float a = side(t[0], t[1], p), b = side(t[1], t[2], p), c = side(t[2], t[0], p);
    if ((a >= 0 && b >= 0 && c >= 0) || (a <= 0 && b <= 0 && c <= 0)) {
      if (side(t[0], t[1], t[2]) != 0) return p;
    }
    Point best = t[0];
    for (int k = 0; k < 3; ++k) {
      const Point from = t[k], to = t[(k + 1) % 3], d{to.x - from.x, to.y - from.y};
      const float size = d.x * d.x + d.y * d.y;
      const float along = size > 0 ? ((p.x - from.x) * d.x + (p.y - from.y) * d.y) / size : 0;
      const float part = std::clamp(along, 0.0f, 1.0f);
      const Point q{from.x + part * d.x, from.y + part * d.y};
      if (squared(q, p) < squared(best, p)) best = q;
    }
    return best;
  }

  // Which wedges of v and u become one: those that a face on the edge joins. Then the sums of their quadrics and of
  // the first `columns` slopes, with origin v and with the values of the group's wedge.
  void join(const State& s, int32_t v, int32_t u, int columns) {
    const Vertex &a = s.vertices[v], &b = s.vertices[u];
    const Vec3 t = a.p - b.p;
    quadric = b.q;
    quadric.move_origin(t);
    quadric += a.q;
    members_.clear();
    groups_.clear();
    own_.clear();
    if (!columns && !fixed_) return;
    if (!s.columns) return;
    group_wedges(s, v, u);
    slopes_.assign(groups_.size() * static_cast<size_t>(columns), Slope{});
    for (size_t i = 0; i < groups_.size(); ++i) groups_[i].first = static_cast<int>(i) * columns, groups_[i].weight = 0;
    for (size_t i = 0; i < members_.size(); ++i) {
      const int32_t wedge = members_[i].first;
      const bool of_u = of_u_[i];
      Group& g = groups_[members_[i].second];
      const float w = s.weight[wedge];
      g.weight += w;
      const float *here = &s.value[static_cast<size_t>(wedge) * s.columns],
                  *there = &s.value[static_cast<size_t>(g.wedge) * s.columns];
      const Slope* from = &s.slope[static_cast<size_t>(wedge) * s.columns];
      for (int k = 0; k < columns; ++k) {
        Slope m = from[k];
        if (of_u) m.d = m.at(t);
        if (wedge != g.wedge) {
          const float step = there[k] - here[k];
          if (k < s.steering) shift(m, step, w);
          m.d -= step * w;
        }
        slopes_[g.first + k] += m;
      }
    }
  }

  // The quadric's terms when an attribute is counted from a value `step` higher.
  void shift(const Slope& m, float step, float weight) {
    quadric.bx -= step * m.x, quadric.by -= step * m.y, quadric.bz -= step * m.z;
    quadric.c -= step * (2 * m.d - step * weight);
  }

  static int32_t wedge_of(const State& s, int32_t v) {
    int32_t c = s.vertices[v].head;
    while (s.faces[face_of(c)].dead()) c = s.faces[face_of(c)].next[slot_of(c)];
    return s.wedges[face_of(c)].w[slot_of(c)];
  }

  void group_wedges(const State& s, int32_t v, int32_t u) {
    of_u_.clear();
    if (!((s.flags[v] | s.flags[u]) & kSeveralWedges) && !s.has_links) {  // by far the most
      members_.push_back({wedge_of(s, v), 0});
      members_.push_back({wedge_of(s, u), 0});
      groups_.push_back({members_[0].first, 0, 0});
      of_u_.push_back(0), of_u_.push_back(1);
      own_.push_back(1);
      return;
    }
    const auto number = [&](int32_t wedge, bool of_u) {
      for (size_t i = 0; i < members_.size(); ++i)
        if (members_[i].first == wedge) return static_cast<int>(i);
      members_.push_back({wedge, static_cast<int32_t>(members_.size())});
      of_u_.push_back(of_u);
      return static_cast<int>(members_.size()) - 1;
    };
    const bool several = (s.flags[v] | s.flags[u]) & kSeveralWedges;
    for (const bool of_u : {false, true})
      for (int32_t c = s.vertices[of_u ? u : v].head; c != kNone; c = s.faces[face_of(c)].next[slot_of(c)]) {
        const Face& f = s.faces[face_of(c)];
        if (f.dead() || f.link()) continue;
        const int mine = number(s.wedges[face_of(c)].w[slot_of(c)], of_u);
        if (!of_u) {
          if (!several) break;
          continue;
        }
        for (int k = 0; k < 3; ++k)
          if (f.v[k] == v) {
            const int32_t other = members_[number(s.wedges[face_of(c)].w[k], false)].second, own = members_[mine].second;
            if (other != own)
              for (auto& m : members_)
                if (m.second == std::max(own, other)) m.second = std::min(own, other);
            if (!several) goto found;
          }
      }
  found:
    // number the groups without gaps; a wedge of v stands for its group if there is one (those come first)
    for (size_t i = 0; i < members_.size(); ++i) {
      int32_t& group = members_[i].second;
      if (group == static_cast<int32_t>(i)) {
        group = static_cast<int32_t>(groups_.size());
        groups_.push_back({members_[i].first, 0, 0});
        own_.push_back(!of_u_[i]);
        renumber_.resize(std::max(renumber_.size(), i + 1));
        renumber_[i] = group;
      } else {
        group = renumber_[group];
        own_[group] = static_cast<uint8_t>(own_[group] + !of_u_[i]);
      }
    }
  }

  std::vector<std::pair<int32_t, int32_t>> members_, links_;  // (wedge, group); (gone, kept)
  std::vector<Group> groups_;
  std::vector<uint8_t> of_u_, own_;  // per member; per group: how many wedges of v are in it
  std::vector<int32_t> renumber_;
  std::vector<Slope> slopes_;
  std::vector<float> steps_;
  bool fixed_ = false;
};

}  // namespace lodpipe
