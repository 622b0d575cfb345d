// New UVs at seams stay within their chart.
#pragma once
#include <algorithm>
#include <cmath>

#include "around.h"
#include "mesh_state.h"
#include "wedges.h"

namespace lodpipe {

constexpr float kGutter = 4.0f / 1024;  // UV units beyond a chart's border that textures are expected to be padded by

struct UvPoint {
  float x, y;
};

// A wanted place, and the point nearest to it in the faces of a chart.
class ChartPlace {
 public:
  ChartPlace() = default;
  explicit ChartPlace(UvPoint wanted) : wanted_(wanted), best_(wanted) {}

  void look(const UvPoint* corner) {
    const UvPoint found = nearest_in(wanted_, corner);
    const float away = squared(found, wanted_);
    if (away < away_) away_ = away, best_ = found;
  }

  // The wanted place, or the point at the gutter's end on the way to it.
  UvPoint kept(float gutter) const {
    const float part = away_ > 0 ? std::min(1.0f, gutter / std::sqrt(away_)) : 0.0f;
    return {best_.x + part * (wanted_.x - best_.x), best_.y + part * (wanted_.y - best_.y)};
  }

 private:
  static float squared(UvPoint a, UvPoint b) { return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y); }

  static UvPoint nearest_in(UvPoint p, const UvPoint* t) {
    const auto side = [](UvPoint a, UvPoint b, UvPoint c) {
      return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    };
    const float a = side(t[0], t[1], p), b = side(t[1], t[2], p), c = side(t[2], t[0], p);
    if (((a >= 0 && b >= 0 && c >= 0) || (a <= 0 && b <= 0 && c <= 0)) && side(t[0], t[1], t[2]) != 0) return p;
    UvPoint best = t[0];
    for (int k = 0; k < 3; ++k) {
      const UvPoint from = t[k], to = t[kNext[k]], d{to.x - from.x, to.y - from.y};
      const float size = d.x * d.x + d.y * d.y;
      const float along = size > 0 ? ((p.x - from.x) * d.x + (p.y - from.y) * d.y) / size : 0;
      const float part = std::clamp(along, 0.0f, 1.0f);
      const UvPoint q{from.x + part * d.x, from.y + part * d.y};
      if (squared(q, p) < squared(best, p)) best = q;
    }
    return best;
  }

  UvPoint wanted_{}, best_{};
  float away_ = kInfinity;  // squared distance between them
};

// A group's best fit may lie outside its chart, where the texture shows something else: then the point that is nearest
// to the faces which the group has round v and u takes its place, but for the width of a gutter.
class ChartKeeper {
 public:
  // `steps` (groups × columns) lead from the values of the groups' wedges to the wanted ones.
  void run(const State& s, const WedgeGroups& groups, const Around& around, float* steps) {
    places_.resize(groups.size());
    for (size_t g = 0; g < groups.size(); ++g) {
      const UvPoint value = uv(s, groups[g].wedge);
      const float* step = steps + g * s.columns + s.chart_column;
      places_[g] = ChartPlace({value.x + step[0], value.y + step[1]});
    }
    for (const Buffer<Spoke>* ring : {&around.between, &around.of_v, &around.of_u})
      for (const Spoke& spoke : *ring) {
        if (spoke.link()) continue;
        const int32_t* w = s.wedges[face_of(spoke.corner)].w;
        const UvPoint corner[3] = {uv(s, w[0]), uv(s, w[1]), uv(s, w[2])};
        look(w[slot_of(spoke.corner)], corner, groups);
        if (ring != &around.between) continue;  // the faces on the edge are of both ends
        for (int k = 0; k < 3; ++k)
          if (k != slot_of(spoke.corner)) look(w[k], corner, groups);
      }
    const float gutter = kGutter * s.column_scale[s.chart_column];  // values that steer are scaled
    for (size_t g = 0; g < groups.size(); ++g) {
      const UvPoint kept = places_[g].kept(gutter), value = uv(s, groups[g].wedge);
      float* step = steps + g * s.columns + s.chart_column;
      step[0] = kept.x - value.x, step[1] = kept.y - value.y;
    }
  }

 private:
  static UvPoint uv(const State& s, int32_t wedge) {
    const float* value = s.values(wedge) + s.chart_column;
    return {value[0], value[1]};
  }

  void look(int32_t wedge, const UvPoint* corner, const WedgeGroups& groups) {
    const int32_t group = groups.group_of(wedge);
    if (group != kNone) places_[group].look(corner);
  }

  Buffer<ChartPlace> places_;
};

}  // namespace lodpipe
