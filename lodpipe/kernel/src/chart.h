// New UVs at seams stay within their chart.
#pragma once
#include <algorithm>
#include <cmath>

#include "around.h"
#include "mesh_state.h"
#include "wedges.h"

namespace lodpipe {

constexpr float kGutter = 4.0f / 1024;  // UV units beyond a chart's border that textures are expected to be padded by

// A group's best fit may lie outside its chart, where the texture shows something else: then the point that is nearest
// to the faces which the group has round v and u takes its place, but for the width of a gutter.
class ChartKeeper {
 public:
  // `steps` (groups × columns) lead from the values of the groups' wedges to the wanted ones.
  void run(const State& s, const WedgeGroups& groups, const Around& around, float* steps) {
    places_.resize(groups.size());
    for (size_t g = 0; g < groups.size(); ++g) {
      const float *value = uv(s, groups[g].wedge), *step = steps + g * s.columns + s.chart_column;
      const Point wanted{value[0] + step[0], value[1] + step[1]};
      places_[g] = {wanted, wanted, kInfinity};
    }
    for (const Buffer<Spoke>* ring : {&around.between, &around.of_v, &around.of_u})
      for (const Spoke& spoke : *ring) {
        if (spoke.link()) continue;
        const int32_t* w = s.wedges[face_of(spoke.corner)].w;
        Point corner[3];
        for (int k = 0; k < 3; ++k) corner[k] = {uv(s, w[k])[0], uv(s, w[k])[1]};
        look(w[slot_of(spoke.corner)], corner, groups);
        if (ring != &around.between) continue;  // the faces on the edge are of both ends
        for (int k = 0; k < 3; ++k)
          if (k != slot_of(spoke.corner)) look(w[k], corner, groups);
      }
    const float gutter = kGutter * s.column_scale[s.chart_column];  // values that steer are scaled
    for (size_t g = 0; g < groups.size(); ++g) {
      const Place& p = places_[g];
      const float part = p.away > 0 ? std::min(1.0f, gutter / std::sqrt(p.away)) : 0.0f;
      const float* value = uv(s, groups[g].wedge);
      float* step = steps + g * s.columns + s.chart_column;
      step[0] = p.best.x + part * (p.wanted.x - p.best.x) - value[0];
      step[1] = p.best.y + part * (p.wanted.y - p.best.y) - value[1];
    }
  }

 private:
  struct Point {
    float x, y;
  };
  struct Place {
    Point wanted, best;
    float away;  // squared distance between them
  };

  static const float* uv(const State& s, int32_t wedge) {
    return s.values(wedge) + s.chart_column;
  }

  void look(int32_t wedge, const Point* corner, const WedgeGroups& groups) {
    const int32_t group = groups.group_of(wedge);
    if (group == kNone) return;
    Place& p = places_[group];
    const Point found = nearest_in(p.wanted, corner);
    const float away = squared(found, p.wanted);
    if (away < p.away) p.away = away, p.best = found;
  }

  static float squared(Point a, Point b) { return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y); }

  static Point nearest_in(Point p, const Point* t) {
    const auto side = [](Point a, Point b, Point c) { return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x); };
    const float a = side(t[0], t[1], p), b = side(t[1], t[2], p), c = side(t[2], t[0], p);
    if (((a >= 0 && b >= 0 && c >= 0) || (a <= 0 && b <= 0 && c <= 0)) && side(t[0], t[1], t[2]) != 0) return p;
    Point best = t[0];
    for (int k = 0; k < 3; ++k) {
      const Point from = t[k], to = t[kNext[k]], d{to.x - from.x, to.y - from.y};
      const float size = d.x * d.x + d.y * d.y;
      const float along = size > 0 ? ((p.x - from.x) * d.x + (p.y - from.y) * d.y) / size : 0;
      const float part = std::clamp(along, 0.0f, 1.0f);
      const Point q{from.x + part * d.x, from.y + part * d.y};
      if (squared(q, p) < squared(best, p)) best = q;
    }
    return best;
  }

  Buffer<Place> places_;
};

}  // namespace lodpipe
