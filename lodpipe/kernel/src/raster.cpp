#include "raster.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "memory.h"

namespace lodpipe {

namespace {

constexpr double kNear = 1e-3;  // radii, before the eye of a perspective view

struct Seen {
  double x, y, z;  // pixels from the left and from the top of the rows drawn, and the depth
};

// Twice the area of the triangle of an edge and a pixel; exactly the opposite for the edge the other way round.
struct Edge {
  Seen a;
  double dx, dy, sign;
  Edge(const Seen* seen, int32_t from, int32_t to) {
    sign = from < to ? 1 : -1;
    a = seen[std::min(from, to)];
    dx = seen[std::max(from, to)].x - a.x;
    dy = seen[std::max(from, to)].y - a.y;
  }
  double operator()(double x, double y) const { return sign * (dx * (y - a.y) - dy * (x - a.x)); }
};

// Pixels of which something is looked for: all, or those where `behind` is finite.
struct Window {
  int left, top, right, bottom;  // the last two are the last
};

Window window(const float* behind, int width, int rows) {
  if (!behind) return {0, 0, width - 1, rows - 1};
  Window found{width, rows, -1, -1};
  for (int y = 0; y < rows; ++y)
    for (int x = 0; x < width; ++x)
      if (std::isfinite(behind[static_cast<size_t>(y) * width + x])) {
        found.top = std::min(found.top, y), found.bottom = y;
        found.left = std::min(found.left, x), found.right = std::max(found.right, x);
      }
  return found;
}

int floor_of(double x) { return static_cast<int>(x); }  // of a number that is not negative
int ceil_of(double x) { return static_cast<int>(x) + (x > static_cast<int>(x)); }

}  // namespace

Raster raster(const float* positions, int vertices, const int32_t* faces, int count, const RasterView& view,
              const float* behind) {
  const int rows = view.bottom - view.top;
  const size_t pixels = static_cast<size_t>(view.width) * rows;
  Raster out{true, {}, {}, {}};
  Large<Seen> seen(vertices);
  const double scale = view.height / (2 * view.size), middle_x = view.width / 2.0, middle_y = view.height / 2.0 - view.top;
  for (int v = 0; v < vertices; ++v) {
    const float* p = positions + 3 * static_cast<size_t>(v);
    const double to[3] = {p[0] - view.eye[0], p[1] - view.eye[1], p[2] - view.eye[2]};
    const auto along = [&](const double* axis) { return to[0] * axis[0] + to[1] * axis[1] + to[2] * axis[2]; };
    const double depth = along(view.ahead);
    if (view.perspective && depth < kNear) return {false, {}, {}, {}};
    const double s = view.perspective ? scale / depth : scale;
    seen[v] = {middle_x + along(view.right) * s, middle_y - along(view.up) * s, depth};
  }
  out.distance.assign(pixels, std::numeric_limits<float>::infinity());
  out.face.assign(pixels, -1);
  out.uv.assign(2 * pixels, 0.0f);
  const double across = 2 * view.size / view.height;  // of a pixel, at a depth of 1
  const Window in = window(behind, view.width, rows);
  for (int f = 0; f < count; ++f) {
    const int32_t* v = faces + 3 * static_cast<size_t>(f);
    const Seen &a = seen[v[0]], &b = seen[v[1]], &c = seen[v[2]];
    // pixels whose centres lie within the box
    const double left = std::min({a.x, b.x, c.x}), right = std::max({a.x, b.x, c.x});
    const double above = std::min({a.y, b.y, c.y}), below = std::max({a.y, b.y, c.y});
    if (!(right >= in.left + 0.5 && below >= in.top + 0.5 && left <= in.right + 0.5 && above <= in.bottom + 0.5)) continue;
    const int x0 = ceil_of(std::max(left - 0.5, static_cast<double>(in.left)));
    const int y0 = ceil_of(std::max(above - 0.5, static_cast<double>(in.top)));
    const int x1 = floor_of(std::min(right - 0.5, static_cast<double>(in.right)));
    const int y1 = floor_of(std::min(below - 0.5, static_cast<double>(in.bottom)));
    if (x0 > x1 || y0 > y1) continue;
    const Edge bc(seen.data(), v[1], v[2]), ca(seen.data(), v[2], v[0]), ab(seen.data(), v[0], v[1]);
    const double whole = ab(c.x, c.y);
    if (!(whole != 0)) continue;
    const double side = whole > 0 ? 1 : -1;
    for (int y = y0; y <= y1; ++y)
      for (int x = x0; x <= x1; ++x) {
        const double px = x + 0.5, py = y + 0.5;
        double u = side * bc(px, py), w = side * ca(px, py), t = side * ab(px, py);
        if (u < 0 || w < 0 || t < 0) continue;
        if (view.perspective) u /= a.z, w /= b.z, t /= c.z;
        const double sum = u + w + t;
        if (!(sum > 0)) continue;
        u /= sum, w /= sum, t /= sum;
        double depth = u * a.z + w * b.z + t * c.z;
        if (view.perspective) {
          const double dx = (px - middle_x) * across, dy = (py - middle_y) * across;
          depth *= std::sqrt(1 + dx * dx + dy * dy);
        }
        const float distance = static_cast<float>(depth);
        const size_t at = static_cast<size_t>(y) * view.width + x;
        if (!(distance < out.distance[at]) || distance <= (behind ? behind[at] : 0.0f)) continue;
        out.distance[at] = distance;
        out.face[at] = f;
        out.uv[2 * at] = static_cast<float>(w);
        out.uv[2 * at + 1] = static_cast<float>(t);
      }
  }
  return out;
}

}  // namespace lodpipe
