#include "mesh.h"

#include <algorithm>

namespace lodpipe::similarity {

Mesh::Mesh(const Input& in) : input(in), columns(in.columns) {
  const auto solid = [&](const int32_t* f) { return f[0] != f[1] && f[1] != f[2] && f[0] != f[2]; };
  Point low{1e308, 1e308, 1e308}, high{-1e308, -1e308, -1e308};
  for (int f = 0; f < in.face_count; ++f) {
    const int32_t* v = in.faces + 3 * static_cast<size_t>(f);
    if (!solid(v)) continue;
    for (int k = 0; k < 3; ++k) {
      const double* x = in.positions + 3 * static_cast<size_t>(v[k]);
      low = {std::min(low.x, x[0]), std::min(low.y, x[1]), std::min(low.z, x[2])};
      high = {std::max(high.x, x[0]), std::max(high.y, x[1]), std::max(high.z, x[2])};
    }
  }
  double half = 0.5;
  if (low.x <= high.x) {
    center = low * 0.5 + high * 0.5;  // halved first: the extent of huge meshes would overflow
    const Point extent = high * 0.5 - low * 0.5;
    const double most = std::max({extent.x, extent.y, extent.z});
    if (most > 1e-300) half = most * length(extent * (1 / most));
  }
  scale = 0.5 / half;
  p.resize(in.vertex_count);
  for (int v = 0; v < in.vertex_count; ++v) {
    const double* x = in.positions + 3 * static_cast<size_t>(v);
    p[v] = (Point{x[0], x[1], x[2]} - center) * scale;
  }
  ring.resize(in.vertex_count);
  vertex_moved.assign(in.vertex_count, 0);
  wedge_moved.assign(in.wedge_count, 0);
  value.assign(in.values, in.values + static_cast<size_t>(in.wedge_count) * columns);
  for (int f = 0; f < in.face_count; ++f) {
    const int32_t *v = in.faces + 3 * static_cast<size_t>(f), *w = in.wedges + 3 * static_cast<size_t>(f);
    if (!solid(v)) continue;
    faces.push_back({{v[0], v[1], v[2]}, {w[0], w[1], w[2]}, f});
    for (int k = 0; k < 3; ++k) ring[v[k]].push_back(static_cast<int32_t>(faces.size()) - 1);
    mean_area += length(area_vector(faces.back()));
  }
  triangles = static_cast<int64_t>(faces.size());
  if (triangles) mean_area /= static_cast<double>(triangles);
}

void Mesh::neighbours(int32_t v, std::vector<std::pair<int32_t, int>>& out) const {
  out.clear();
  for (const int32_t f : ring[v])
    for (const int32_t u : faces[f].v)
      if (u != v) out.push_back({u, 1});
  std::sort(out.begin(), out.end());
  size_t kept = 0;
  for (size_t i = 0; i < out.size(); ++i)
    if (kept && out[kept - 1].first == out[i].first) ++out[kept - 1].second;
    else out[kept++] = out[i];
  out.resize(kept);
}

bool Mesh::component(int32_t v, int most, std::vector<int32_t>& out) const {
  out = ring[v];
  for (size_t i = 0; i < out.size(); ++i) {
    if (static_cast<int>(out.size()) > most) return false;
    for (const int32_t u : faces[out[i]].v)
      for (const int32_t f : ring[u])
        if (std::find(out.begin(), out.end(), f) == out.end()) out.push_back(f);
  }
  std::sort(out.begin(), out.end());
  return static_cast<int>(out.size()) <= most;
}

void Mesh::unlink(int32_t face) {
  for (const int32_t v : faces[face].v) ring[v].erase(std::find(ring[v].begin(), ring[v].end(), face));
  faces[face].dead = true;
}

void Mesh::apply(const Collapse& c) {
  for (const int32_t f : c.removed) unlink(f);
  triangles -= static_cast<int64_t>(c.removed.size());
  for (const Collapse::Wedge& w : c.wedges) {
    if (w.row < 0) continue;
    const double* from = c.fresh.data() + static_cast<size_t>(w.row) * columns;
    for (int k = 0; k < columns; ++k) value[static_cast<size_t>(w.to) * columns + k] = static_cast<float>(from[k]);
    wedge_moved[w.to] = 1;
  }
  for (const int32_t v : {c.gone, c.kept})
    for (const int32_t f : ring[v]) {
      const int k = faces[f].slot(v);
      if (const Collapse::Wedge* w = c.find(faces[f].w[k])) faces[f].w[k] = w->to;
      faces[f].v[k] = c.kept;
    }
  ring[c.kept].insert(ring[c.kept].end(), ring[c.gone].begin(), ring[c.gone].end());
  ring[c.gone].clear();
  if (c.moves) p[c.kept] = c.place, vertex_moved[c.kept] = 1;
}

void Mesh::vanish(const Collapse& c) {
  for (const int32_t f : c.removed) unlink(f);
  triangles -= static_cast<int64_t>(c.removed.size());
}

Point Mesh::world(int32_t v) const {
  if (vertex_moved[v]) return center + p[v] * (1 / scale);
  const double* x = input.positions + 3 * static_cast<size_t>(v);
  return {x[0], x[1], x[2]};
}

void Mesh::values_of(int32_t wedge, float* out) const {
  std::copy_n(values(wedge), columns, out);
}

void Mesh::emit(int64_t target, Stop stop, bool relaxed, double error, std::vector<Level>& out) const {
  Level level;
  level.target = target;
  level.stop = stop;
  level.relaxed = relaxed;
  level.error = error / scale;
  std::vector<int32_t> number(p.size(), kNone), wedge_number(wedge_moved.size(), kNone);
  for (const Face& f : faces) {
    if (f.dead) continue;
    level.face_source.push_back(f.source);
    for (int k = 0; k < 3; ++k) {
      int32_t& n = number[f.v[k]];
      if (n == kNone) {
        n = static_cast<int32_t>(level.vertex_source.size());
        level.vertex_source.push_back(vertex_moved[f.v[k]] ? kNone : f.v[k]);
        const Point x = world(f.v[k]);
        level.positions.insert(level.positions.end(), {x.x, x.y, x.z});
      }
      level.faces.push_back(n);
      int32_t& w = wedge_number[f.w[k]];
      if (w == kNone) {
        w = static_cast<int32_t>(level.wedge_source.size());
        level.wedge_source.push_back(wedge_moved[f.w[k]] ? kNone : f.w[k]);
        const size_t at = level.values.size();
        level.values.resize(at + columns);
        values_of(f.w[k], level.values.data() + at);
      }
      level.wedges.push_back(w);
    }
  }
  out.push_back(std::move(level));
}

void Mesh::note(const Collapse& c, int32_t gone, int removed, double error, Record& out) const {
  const auto row = static_cast<int32_t>(out.removed.size());
  out.removed.push_back(gone);
  out.kept.push_back(c.kept);
  out.triangles.push_back(removed);
  out.error.push_back(static_cast<float>(error / scale));
  const Point x = world(c.kept);
  out.positions.insert(out.positions.end(), {x.x, x.y, x.z});
  for (const Collapse::Wedge& w : c.wedges) {
    if (w.from == w.to && w.row < 0) continue;
    out.wedge_event.push_back(row);
    out.wedge_from.push_back(w.from);
    out.wedge_to.push_back(w.to);
    const size_t at = out.wedge_values.size();
    out.wedge_values.resize(at + columns);
    values_of(w.to, out.wedge_values.data() + at);
  }
}

}  // namespace lodpipe::similarity
