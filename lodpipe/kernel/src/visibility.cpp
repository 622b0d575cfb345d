#include "visibility.h"

#include <algorithm>
#include <cmath>
#include <mutex>

#include "memory.h"
#include "parallel.h"
#include "quadric.h"

namespace lodpipe {
namespace {

constexpr int kGrain = 16384;
constexpr float kNear = 2;   // pixels behind what a picture shows within which a vertex counts as seen
constexpr float kPrior = 4;  // pixels that this counts like: what decides where faces are smaller than pixels

struct Pixel {
  float near = -kInfinity, far = kInfinity;  // how far towards the view, and away from it
  int32_t front = -1, back = -1;             // the faces there
};

// What is nearest to a view, and what is nearest to the opposite one, at once.
class Picture {
 public:
  explicit Picture(int side) : side_(side), pixels_(static_cast<size_t>(side) * side) {}

  const std::vector<Pixel>& pixels() const { return pixels_; }
  const Pixel& at(Vec3 p) const {
    const int x = std::clamp(static_cast<int>(p.x + 0.5f), 0, side_ - 1), y = std::clamp(static_cast<int>(p.y + 0.5f), 0, side_ - 1);
    return pixels_[static_cast<size_t>(y) * side_ + x];
  }

  // x and y in pixels, their centres at whole numbers; z towards the view.
  void draw(int32_t face, Vec3 a, Vec3 b, Vec3 c) {
    const int x0 = up(std::min({a.x, b.x, c.x})), x1 = std::min(down(std::max({a.x, b.x, c.x})), side_ - 1);
    const int y0 = up(std::min({a.y, b.y, c.y})), y1 = std::min(down(std::max({a.y, b.y, c.y})), side_ - 1);
    if (x0 > x1 || y0 > y1) return;  // of most faces of a fine mesh no pixel's centre is met
    float area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if (area == 0) return;
    if (area < 0) std::swap(b, c), area = -area;
    for (int y = y0; y <= y1; ++y) {
      const auto py = static_cast<float>(y);
      Pixel* row = &pixels_[static_cast<size_t>(y) * side_];
      for (int x = x0; x <= x1; ++x) {
        const auto px = static_cast<float>(x);
        const float u = (c.x - b.x) * (py - b.y) - (c.y - b.y) * (px - b.x);
        const float v = (a.x - c.x) * (py - c.y) - (a.y - c.y) * (px - c.x);
        const float w = (b.x - a.x) * (py - a.y) - (b.y - a.y) * (px - a.x);
        if (u < 0 || v < 0 || w < 0) continue;
        const float z = (u * a.z + v * b.z + w * c.z) / area;
        if (z > row[x].near) row[x].near = z, row[x].front = face;
        if (z < row[x].far) row[x].far = z, row[x].back = face;
      }
    }
  }

 private:
  // The whole number at or below, or above. Numbers are larger than −1.
  static int down(float x) { return static_cast<int>(x + 1) - 1; }
  static int up(float x) {
    const int below = static_cast<int>(x);
    return x > static_cast<float>(below) ? below + 1 : below;
  }

  int side_;
  std::vector<Pixel> pixels_;
};

struct Axes {
  double right[3], up[3], towards[3];
};

Axes axes(const double* towards) {
  Axes a;
  int least = 0;
  for (int k = 0; k < 3; ++k) {
    a.towards[k] = towards[k];
    if (std::abs(towards[k]) < std::abs(towards[least])) least = k;
  }
  double helper[3] = {0, 0, 0};
  helper[least] = 1;
  const auto across = [](const double* p, const double* q, double* to) {
    for (int k = 0; k < 3; ++k) to[k] = p[(k + 1) % 3] * q[(k + 2) % 3] - p[(k + 2) % 3] * q[(k + 1) % 3];
    const double length = std::sqrt(to[0] * to[0] + to[1] * to[1] + to[2] * to[2]);
    for (int k = 0; k < 3; ++k) to[k] /= length;
  };
  across(towards, helper, a.right);
  across(towards, a.right, a.up);
  return a;
}

}  // namespace

std::vector<float> vertex_visibility(const VisibilityInput& in) {
  Pool pool(std::max(in.threads, 1));
  std::vector<int32_t> met(in.face_count, 0), open(in.vertex_count, 0);  // pixels of a face, views of a vertex
  std::mutex mutex;
  pool.run(in.view_count, [&](int view) {
    const Axes to = axes(in.views + 3 * static_cast<size_t>(view));
    Large<Vec3> at(in.vertex_count);
    const auto along = [](const double* axis, const float* p) { return axis[0] * p[0] + axis[1] * p[1] + axis[2] * p[2]; };
    for (int v = 0; v < in.vertex_count; ++v) {
      const float* p = in.positions + 3 * static_cast<size_t>(v);
      at[v] = {static_cast<float>((along(to.right, p) + 1) * in.side / 2 - 0.5),
               static_cast<float>((along(to.up, p) + 1) * in.side / 2 - 0.5), static_cast<float>(along(to.towards, p))};
    }
    Picture picture(in.side);
    for (int f = 0; f < in.face_count; ++f) {
      if (!in.hides[f]) continue;
      const int32_t* v = in.faces + 3 * static_cast<size_t>(f);
      picture.draw(f, at[v[0]], at[v[1]], at[v[2]]);
    }
    const float reach = 2 * kNear / static_cast<float>(in.side);
    const std::lock_guard lock(mutex);
    for (int v = 0; v < in.vertex_count; ++v) {
      const Pixel& p = picture.at(at[v]);
      open[v] += (at[v].z >= p.near - reach) + (at[v].z <= p.far + reach);
    }
    for (const Pixel& p : picture.pixels())
      if (p.front >= 0) ++met[p.front], ++met[p.back];
  });
  std::vector<float> alone(in.face_count);  // pixels that a face would take up, one side of it
  pool.range(in.face_count, kGrain, [&](int begin, int end) {
    for (int f = begin; f < end; ++f) {
      const int32_t* v = in.faces + 3 * static_cast<size_t>(f);
      const auto at = [&](int k) {
        const float* p = in.positions + 3 * static_cast<size_t>(v[k]);
        return Vec3{p[0], p[1], p[2]};
      };
      const Vec3 across = cross(at(1) - at(0), at(2) - at(0));
      double sum = 0;
      for (int i = 0; i < in.view_count; ++i) {
        const double* to = in.views + 3 * static_cast<size_t>(i);
        sum += std::abs(across.x * to[0] + across.y * to[1] + across.z * to[2]);
      }
      alone[f] = static_cast<float>(sum / 2 * in.side * in.side / 4);
    }
  });
  std::vector<float> seen(in.vertex_count, 0.0f), wanted(in.vertex_count, 0.0f);
  std::vector<uint8_t> prior(in.vertex_count, 0);
  for (int f = 0; f < in.face_count; ++f)
    for (int k = 0; k < 3; ++k) {
      const int32_t v = in.faces[3 * static_cast<size_t>(f) + k];
      wanted[v] += alone[f], prior[v] |= in.hides[f];
      seen[v] += in.hides[f] ? static_cast<float>(met[f]) : alone[f];
    }
  for (int v = 0; v < in.vertex_count; ++v) {
    // of the views and their opposites half look at one side
    if (prior[v]) seen[v] += kPrior * static_cast<float>(open[v]) / static_cast<float>(in.view_count), wanted[v] += kPrior;
    seen[v] = wanted[v] > 0 ? std::min(seen[v] / wanted[v], 1.0f) : 0.0f;
  }
  std::vector<float> spread = seen;
  for (int f = 0; f < in.face_count; ++f) {
    const int32_t* v = in.faces + 3 * static_cast<size_t>(f);
    const float most = std::max({seen[v[0]], seen[v[1]], seen[v[2]]});
    for (int k = 0; k < 3; ++k) spread[v[k]] = std::max(spread[v[k]], most);
  }
  return spread;
}

}  // namespace lodpipe
