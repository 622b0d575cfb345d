#include "plan.h"

#include <algorithm>

namespace lodpipe::similarity {
namespace {

constexpr int kVanishFaces = 4;         // a component of so few faces goes as a whole
constexpr double kFarthest = 8;          // barycentric coordinates up to which a chart is extended
constexpr double kLeastQuality = 1e-3;  // 2·area / longest edge², below which a new face is a sliver

int count_of(const std::vector<std::pair<int32_t, int>>& near, int32_t v) {
  const auto it = std::lower_bound(near.begin(), near.end(), std::pair(v, 0));
  return it != near.end() && it->first == v ? it->second : 0;
}

}  // namespace

Planner::Planner(const Mesh& mesh, const Options& options, const Scene& scene)
    : mesh_(mesh), options_(options), scene_(scene), placement_(mesh, scene.uv_column),
      topology(options.keep_topology ? Topology::links : Topology::edges) {
  if (scene.uv_column >= 0) uv_columns_.push_back(scene.uv_column);
  for (const Look& look : scene.looks)
    if (look.uv_column >= 0 && std::find(uv_columns_.begin(), uv_columns_.end(), look.uv_column) == uv_columns_.end())
      uv_columns_.push_back(look.uv_column);
}

Stop Planner::plan(int32_t gone, int32_t kept, Collapse& c, Scratch& w, bool* exists) const {
  if (options_.full && mesh_.locked(gone)) std::swap(gone, kept);
  c.gone = gone, c.kept = kept;
  c.before.clear(), c.after.clear(), c.removed.clear(), c.wedges.clear(), c.fresh.clear();
  c.moves = c.whole = false;
  c.place = mesh_.p[kept];
  *exists = false;
  if (mesh_.ring[gone].size() <= kVanishFaces && mesh_.component(gone, kVanishFaces, c.before)) {
    for (const int32_t f : c.before) *exists |= mesh_.faces[f].has(gone) && mesh_.faces[f].has(kept);
    if (!*exists) return Stop::topology;
    c.removed = c.before;
    c.whole = true;
    for (const int32_t f : c.before)
      for (const int32_t v : mesh_.faces[f].v)
        if (mesh_.locked(v)) return Stop::locked;
    if (options_.keep_last && static_cast<int64_t>(c.before.size()) >= mesh_.triangles) return Stop::last;
    c.deviation = placement_.deviation(gone, kept, c.place);
    return Stop::triangles;
  }
  c.before.clear();
  for (const int32_t f : mesh_.ring[gone]) {
    c.before.push_back(f);
    (mesh_.faces[f].has(kept) ? c.removed : c.after).push_back(f);
  }
  *exists = !c.removed.empty();
  if (!*exists) return Stop::topology;
  if (options_.full)
    for (const int32_t f : mesh_.ring[kept])
      if (!mesh_.faces[f].has(gone)) c.before.push_back(f), c.after.push_back(f);
  if (options_.keep_last && static_cast<int64_t>(c.removed.size()) >= mesh_.triangles) return Stop::last;
  if (mesh_.locked(gone) || (mesh_.input.locked && strands_locked(c))) return Stop::locked;
  if (!keeps_topology(c, w)) return Stop::topology;
  if (!group_wedges(c, w)) return Stop::seams;
  if (options_.full && !mesh_.locked(kept)) carry_full(c, w);
  else if (!carry_half(c, w)) return Stop::seams;
  if (turns(c)) return Stop::flip;
  c.deviation = placement_.deviation(gone, kept, c.place);
  return Stop::triangles;
}

// No edge of more than two faces comes about (Liao 2004, section 2.1.1); with Topology::links moreover the vertices
// adjacent to both ends are just those opposite to the edge (Dey et al. 1999), and no two borders are pinched together.
bool Planner::keeps_topology(const Collapse& c, Scratch& w) const {
  if (topology == Topology::free) return true;
  mesh_.neighbours(c.gone, w.near_gone);
  mesh_.neighbours(c.kept, w.near_kept);
  w.opposite.clear();
  for (const int32_t f : c.removed)
    for (const int32_t v : mesh_.faces[f].v)
      if (v != c.gone && v != c.kept) w.opposite.push_back(v);
  bool gone_open = false, kept_open = false;
  for (const auto& [v, faces] : w.near_kept) kept_open |= faces == 1;
  for (const auto& [v, faces] : w.near_gone) {
    gone_open |= faces == 1;
    const int there = v == c.kept ? 0 : count_of(w.near_kept, v);
    if (!there) continue;
    const auto between = static_cast<int>(std::count(w.opposite.begin(), w.opposite.end(), v));
    if (faces + there - 2 * between > std::max({2, faces, there})) return false;
    if (topology == Topology::links && !between) return false;
  }
  return topology != Topology::links || c.removed.size() == 1 || !gone_open || !kept_open;
}

// Would a locked vertex lose its last face?
bool Planner::strands_locked(const Collapse& c) const {
  for (const int32_t f : c.removed)
    for (const int32_t v : mesh_.faces[f].v) {
      if (!mesh_.locked(v)) continue;
      size_t going = 0;
      for (const int32_t g : mesh_.ring[v]) going += std::find(c.removed.begin(), c.removed.end(), g) != c.removed.end();
      if (v == c.kept ? c.after.empty() && going == mesh_.ring[v].size() : going == mesh_.ring[v].size()) return true;
    }
  return false;
}

// Which wedges of the two vertices become one: those that a face on the edge joins. Members of `kept` come first in
// each group. False if a group would join two wedges of `kept` in a half-edge collapse: that would tear a seam.
bool Planner::group_wedges(const Collapse& c, Scratch& w) const {
  w.members.clear(), w.group.clear();
  const auto number = [&](int32_t wedge) {
    const auto it = std::find(w.members.begin(), w.members.end(), wedge);
    if (it != w.members.end()) return static_cast<size_t>(it - w.members.begin());
    w.members.push_back(wedge);
    w.group.push_back(static_cast<int>(w.group.size()));
    return w.members.size() - 1;
  };
  for (const int32_t f : mesh_.ring[c.kept]) number(mesh_.faces[f].w[mesh_.faces[f].slot(c.kept)]);
  w.of_kept = static_cast<int>(w.members.size());
  for (const int32_t f : mesh_.ring[c.gone]) number(mesh_.faces[f].w[mesh_.faces[f].slot(c.gone)]);
  for (const int32_t f : c.removed) {
    const Face& face = mesh_.faces[f];
    const int a = w.group[number(face.w[face.slot(c.gone)])], b = w.group[number(face.w[face.slot(c.kept)])];
    for (int& g : w.group)
      if (g == std::max(a, b)) g = std::min(a, b);
  }
  w.slot.assign(w.members.size(), -1);
  w.groups.clear();
  for (size_t i = 0; i < w.members.size(); ++i) {
    int& slot = w.slot[w.group[i]];
    if (slot < 0) slot = static_cast<int>(w.groups.size()), w.groups.emplace_back();
    else if (!options_.full && static_cast<int>(i) < w.of_kept) return false;
    w.groups[slot].push_back(w.members[i]);
  }
  return true;
}

// A half-edge collapse takes the wedges of the vertex that stays. A chart that does not reach it is extended to it.
bool Planner::carry_half(Collapse& c, Scratch& w) const {
  for (const auto& group : w.groups) {
    const bool reaches = std::find(w.members.begin(), w.members.begin() + w.of_kept, group[0]) != w.members.begin() + w.of_kept;
    for (size_t i = reaches; i < group.size(); ++i) {
      if (!reaches && !options_.cross_seams) return false;
      c.wedges.push_back({group[i], group[0], reaches ? -1 : extend(c, group[i])});
    }
  }
  return true;
}

// A full collapse takes place and UV from the quadrics, all else from the nearest point of the edge.
void Planner::carry_full(Collapse& c, Scratch& w) const {
  c.place = placement_.best(mesh_, c.gone, c.kept, w.groups, w.uv);
  c.moves = true;
  const Point from = mesh_.p[c.kept], edge = mesh_.p[c.gone] - from;
  const double square = dot(edge, edge);
  const double along = square > 0 ? std::clamp(dot(c.place - from, edge) / square, 0.0, 1.0) : 0;
  const size_t columns = mesh_.columns;
  for (size_t g = 0; g < w.groups.size(); ++g) {
    const int row = static_cast<int>(g);
    c.fresh.resize((g + 1) * columns);
    double* out = c.fresh.data() + g * columns;
    double total = 0;
    size_t ends[2] = {0, 0};
    const auto is_kept = [&](int32_t m) {
      return std::find(w.members.begin(), w.members.begin() + w.of_kept, m) != w.members.begin() + w.of_kept;
    };
    for (const int32_t m : w.groups[g]) ++ends[is_kept(m)];
    for (const int32_t m : w.groups[g]) {
      const bool kept = is_kept(m);
      const double share = (!ends[0] || !ends[1] ? 1.0 : kept ? 1 - along : along) / static_cast<double>(ends[kept]);
      total += share;
      for (size_t k = 0; k < columns; ++k) out[k] += share * mesh_.values(m)[k];
      c.wedges.push_back({m, w.groups[g][0], row});
    }
    for (size_t k = 0; k < columns; ++k) out[k] /= total;
    if (placement_.steers_uv())
      for (int j = 0; j < 2; ++j) out[scene_.uv_column + j] = w.uv[g][j];
  }
}

// The values that `wedge` of c.gone would have at c.kept if its chart went on as it is: UVs as the linear functions over
// its faces have them there, the mean by area; all else as it was. Returns their row of `fresh`.
int Planner::extend(Collapse& c, int32_t wedge) const {
  const size_t columns = mesh_.columns, start = c.fresh.size();
  c.fresh.resize(start + columns);
  double* out = c.fresh.data() + start;
  std::copy_n(mesh_.values(wedge), columns, out);
  double total = 0;
  std::vector<double> sum(columns);
  for (const int32_t i : c.after) {
    const Face& f = mesh_.faces[i];
    const int k = f.slot(c.gone);
    if (!f.has(c.gone) || f.w[k] != wedge) continue;
    const Point n = mesh_.area_vector(f);
    const double square = dot(n, n);
    if (!(square > 0)) continue;
    double share[3];
    for (int j = 0; j < 3; ++j) {
      const Point a = mesh_.p[f.v[(j + 1) % 3]] - mesh_.p[c.kept], b = mesh_.p[f.v[(j + 2) % 3]] - mesh_.p[c.kept];
      share[j] = std::clamp(dot(cross(a, b), n) / (2 * square), -kFarthest, kFarthest);
    }
    const double weight = std::sqrt(square), all = share[0] + share[1] + share[2];
    if (!(std::abs(all) > 0.1)) continue;
    total += weight;
    for (const int u : uv_columns_)
      for (int d = u; d < u + 2; ++d)
        for (int j = 0; j < 3; ++j) sum[d] += weight * share[j] / all * mesh_.values(f.w[j])[d];
  }
  if (total > 0)
    for (const int u : uv_columns_)
      for (int d = u; d < u + 2; ++d) out[d] = sum[d] / total;
  return static_cast<int>(start / columns);
}

// Would a face turn over, or become a sliver that it was not?
bool Planner::turns(const Collapse& c) const {
  for (const int32_t i : c.after) {
    const Face& f = mesh_.faces[i];
    Point x[3], y[3];
    double longest = 0, longest_before = 0;
    for (int k = 0; k < 3; ++k) {
      x[k] = mesh_.p[f.v[k]];
      y[k] = f.v[k] == c.gone || f.v[k] == c.kept ? c.place : x[k];
    }
    for (int k = 0; k < 3; ++k) {
      const Point a = y[(k + 1) % 3] - y[k], b = x[(k + 1) % 3] - x[k];
      longest = std::max(longest, dot(a, a)), longest_before = std::max(longest_before, dot(b, b));
    }
    const Point before = cross(x[1] - x[0], x[2] - x[0]), after = cross(y[1] - y[0], y[2] - y[0]);
    const double size_before = length(before), size = length(after);
    if (!(size_before > 1e-12 * longest_before)) continue;
    if (!(dot(before, after) > options_.flip_cos * size_before * size)) return true;
    if (size < kLeastQuality * longest && size * longest_before < 0.5 * size_before * longest) return true;
  }
  return false;
}

}  // namespace lodpipe::similarity
