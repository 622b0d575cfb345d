// Pairs of vertices that are near each other and share no edge (Garland & Heckbert 1997, section 4: valid pairs).
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>

#include "mesh_state.h"

namespace lodpipe {

constexpr size_t kMostFaces = size_t{1} << 29;  // a corner's number has 31 bits, two of which say which corner

// Appends a link for each pair closer than `distance` (unit box). A hashed grid of cells of that size: expected time is
// linear in vertices and pairs.
inline void add_links(float distance, State& s) {
  struct Cell {
    uint64_t key;
    int32_t vertex;
  };
  const auto key = [](int64_t x, int64_t y, int64_t z) {
    return static_cast<uint64_t>(x) << 42 ^ static_cast<uint64_t>(y) << 21 ^ static_cast<uint64_t>(z);
  };
  const float size = std::max(distance, 1e-6f);  // at most 2²⁰ cells along an axis
  const auto place = [&](float x) { return static_cast<int64_t>(std::floor((x + 1) / size)); };
  std::vector<uint64_t> edges;
  const auto edge = [](int32_t a, int32_t b) {
    return static_cast<uint64_t>(std::min(a, b)) << 32 | static_cast<uint32_t>(std::max(a, b));
  };
  std::vector<uint8_t> used(s.vertices.size(), 0);
  for (const Face& f : s.faces)
    for (int k = 0; k < 3; ++k) edges.push_back(edge(f.v[k], f.v[(k + 1) % 3])), used[f.v[k]] = 1;
  std::sort(edges.begin(), edges.end());
  std::vector<Cell> cells;
  for (int32_t v = 0; v < static_cast<int32_t>(s.vertices.size()); ++v) {
    if (!used[v]) continue;
    const Vec3 p = s.vertices[v].p;
    cells.push_back({key(place(p.x), place(p.y), place(p.z)), v});
  }
  std::sort(cells.begin(), cells.end(), [](Cell a, Cell b) { return a.key != b.key ? a.key < b.key : a.vertex < b.vertex; });
  for (int32_t v = 0; v < static_cast<int32_t>(s.vertices.size()); ++v) {
    const Vec3 p = s.vertices[v].p;
    if (!used[v]) continue;
    for (int64_t x = place(p.x) - 1; x <= place(p.x) + 1; ++x)
      for (int64_t y = place(p.y) - 1; y <= place(p.y) + 1; ++y)
        for (int64_t z = place(p.z) - 1; z <= place(p.z) + 1; ++z) {
          const uint64_t wanted = key(x, y, z);
          auto it = std::lower_bound(cells.begin(), cells.end(), wanted, [](Cell c, uint64_t k) { return c.key < k; });
          for (; it != cells.end() && it->key == wanted; ++it) {
            const int32_t u = it->vertex;
            const Vec3 d = s.vertices[u].p - p;
            if (u <= v || !used[u] || dot(d, d) >= distance * distance) continue;
            if (std::binary_search(edges.begin(), edges.end(), edge(v, u))) continue;
            if (s.faces.size() >= kMostFaces) throw std::length_error("pair_distance finds more than 500 million pairs");
            s.faces.push_back({{v, u, kNone}, kNone});
          }
        }
  }
}

}  // namespace lodpipe
