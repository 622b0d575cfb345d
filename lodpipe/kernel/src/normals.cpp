#include "normals.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "memory.h"
#include "parallel.h"
#include "similarity/vector.h"

namespace lodpipe {

namespace {

using similarity::Point;

constexpr int kGrain = 1 << 14, kReach = 512;
constexpr double kRounding = 1e-9;  // faces that are turned by just the limit count as smooth

struct Flat {
  float x, y, z, angle[3];  // the face's unit normal, and its angles in radians
};

Point corner(const double* positions, int32_t vertex) {
  const double* p = positions + 3 * static_cast<size_t>(vertex);
  return {p[0], p[1], p[2]};
}

Point unit(Point p) {
  const double l = length(p);
  return l > 0 ? p * (1 / l) : p;
}

Point normal(const Flat& f) { return {f.x, f.y, f.z}; }

void store(Point p, float* out) {
  out[0] = static_cast<float>(p.x), out[1] = static_cast<float>(p.y), out[2] = static_cast<float>(p.z);
}

}  // namespace

void crease_normals(const double* positions, int vertices, const int32_t* faces, int count, double least, int threads,
                    float* normals) {
  Pool pool(threads);
  Large<Flat> flat(count);
  pool.range(count, kGrain, [&](int begin, int end) {
    for (int f = begin; f < end; ++f) {
      const int32_t* v = faces + 3 * static_cast<size_t>(f);
      const Point a = corner(positions, v[0]), b = corner(positions, v[1]), c = corner(positions, v[2]);
      const Point ab = unit(b - a), bc = unit(c - b), ca = unit(a - c), n = unit(cross(ab, c - a));
      const auto angle = [](Point u, Point w) {
        return static_cast<float>(std::acos(std::clamp(-dot(u, w), -1.0, 1.0)));
      };
      flat[f] = {static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z),
                 {angle(ca, ab), angle(ab, bc), angle(bc, ca)}};
    }
  });

  Large<Point> mean(vertices);
  std::fill(mean.begin(), mean.end(), Point{});
  for (int f = 0; f < count; ++f)
    for (int k = 0; k < 3; ++k) {
      Point& sum = mean[faces[3 * static_cast<size_t>(f) + k]];
      sum = sum + normal(flat[f]) * flat[f].angle[k];
    }
  pool.range(vertices, kGrain, [&](int begin, int end) {
    for (int v = begin; v < end; ++v) mean[v] = unit(mean[v]);
  });

  // A vertex whose faces are all within half the angle of their mean has no two that are farther apart.
  const double half = std::sqrt(std::max((1 + least) / 2, 0.0));
  std::vector<int32_t> first(static_cast<size_t>(vertices) + 1, 0);  // of each creased vertex, its corners below
  std::vector<uint8_t> creased(vertices, 0);
  for (int f = 0; f < count; ++f)
    for (int k = 0; k < 3; ++k) {
      const int32_t v = faces[3 * static_cast<size_t>(f) + k];
      if (dot(mean[v], normal(flat[f])) < half) creased[v] = 1;
    }
  for (int i = 0; i < 3 * count; ++i) first[faces[i] + 1] += creased[faces[i]];
  for (int v = 0; v < vertices; ++v) first[v + 1] += first[v];
  std::vector<int32_t> corners(first[vertices]);
  {
    std::vector<int32_t> at(first.begin(), first.end() - 1);
    for (int i = 0; i < 3 * count; ++i)
      if (creased[faces[i]]) corners[at[faces[i]]++] = i;
  }

  pool.range(count, kGrain, [&](int begin, int end) {
    for (int i = 3 * begin; i < 3 * end; ++i)
      if (!creased[faces[i]]) store(mean[faces[i]], normals + 3 * static_cast<size_t>(i));
  });
  pool.range(vertices, kGrain, [&](int begin, int end) {
    for (int v = begin; v < end; ++v)
      for (int32_t i = first[v]; i < first[v + 1]; ++i) {
        const Point own = normal(flat[corners[i] / 3]);
        Point sum;
        const int32_t from = std::max(first[v], i - kReach), to = std::min(first[v + 1], i + kReach);
        for (int32_t j = from; j < to; ++j) {
          const Flat& other = flat[corners[j] / 3];
          if (dot(own, normal(other)) >= least - kRounding) sum = sum + normal(other) * other.angle[corners[j] % 3];
        }
        store(unit(sum), normals + 3 * static_cast<size_t>(corners[i]));
      }
  });
}

void face_normals(const float* positions, const int32_t* faces, int count, float* normals) {
  for (int f = 0; f < count; ++f) {
    Point corners[3];
    for (int k = 0; k < 3; ++k) {
      const float* p = positions + 3 * static_cast<size_t>(faces[3 * static_cast<size_t>(f) + k]);
      corners[k] = {p[0], p[1], p[2]};
    }
    store(unit(cross(corners[1] - corners[0], corners[2] - corners[0])), normals + 3 * static_cast<size_t>(f));
  }
}

}  // namespace lodpipe
