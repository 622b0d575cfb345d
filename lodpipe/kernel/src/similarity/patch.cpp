#include "patch.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace lodpipe::similarity {
namespace {

constexpr float kHuge = 1e30f;
constexpr float kSlack = 1e-5f;  // by which bounds are widened: rounding must not lose a hit

using Mask = int __attribute__((vector_size(16)));

// What four triangles cover of the plane that blocks are compared in, as Rays::bounds; whether no ray goes there.
Mask bound(const Rays& rays, const Lanes* corner, Lanes range[4]) {
  range[0] = range[2] = Lanes{} + kHuge, range[1] = range[3] = Lanes{} - kHuge;
  Mask behind{};
  for (int k = 0; k < 3; ++k, corner += 3) {
    const Lanes x = corner[0] - rays.origin.x, y = corner[1] - rays.origin.y, z = corner[2] - rays.origin.z;
    const auto along = [&](Vec3 axis) { return x * axis.x + y * axis.y + z * axis.z; };
    const Lanes depth = -along(rays.back), over = 1 / depth, across = along(rays.right) * over, above = along(rays.up) * over;
    behind |= ~(depth > 1e-2f);  // beside or behind the viewpoint: may be anywhere
    range[0] = across < range[0] ? across : range[0], range[1] = across > range[1] ? across : range[1];
    range[2] = above < range[2] ? above : range[2], range[3] = above > range[3] ? above : range[3];
  }
  for (int k = 0; k < 4; ++k) {
    const float side = k % 2 ? 1 : -1;
    range[k] = (behind ? Lanes{} + side * kHuge : range[k]) + side * kSlack;
  }
  return (range[0] > rays.all[1]) | (range[1] < rays.all[0]) | (range[2] > rays.all[3]) | (range[3] < rays.all[2]);
}

}  // namespace

void Patch::pack() {
  const size_t groups = (look.size() + 3) / 4;
  four.resize(9 * groups);
  for (size_t g = 0; g < groups; ++g)
    for (size_t lane = 0; lane < 4; ++lane) {
      const Vec3* corner = &x[3 * std::min(4 * g + lane, look.size() - 1)];
      for (size_t k = 0; k < 3; ++k) {
        four[9 * g + 3 * k][lane] = corner[k].x;
        four[9 * g + 3 * k + 1][lane] = corner[k].y;
        four[9 * g + 3 * k + 2][lane] = corner[k].z;
      }
    }
}

void Shading::texel(const Look& look, float u, float v, float out[2]) const {
  out[0] = out[1] = 1;
  if (look.image < 0) return;
  const Image& image = scene_.images[look.image];
  float x = u * static_cast<float>(image.width) - 0.5f, y = v * static_cast<float>(image.height) - 0.5f;
  if (!(std::abs(x) < 1e9f) || !(std::abs(y) < 1e9f)) x = y = 0;  // no place: the first texel
  if (image.nearest) x = std::floor(x + 0.5f), y = std::floor(y + 0.5f);
  const float left = std::floor(x), top = std::floor(y), fx = x - left, fy = y - top;
  const auto i = static_cast<int64_t>(left), j = static_cast<int64_t>(top);
  const auto blend = [&](const uint8_t* a, const uint8_t* b, const uint8_t* c, const uint8_t* d) {
    const auto f = [](uint8_t texel) { return static_cast<float>(texel); };
    for (int k = 0; k < 2; ++k)
      out[k] = ((f(a[k]) * (1 - fx) + f(b[k]) * fx) * (1 - fy) + (f(c[k]) * (1 - fx) + f(d[k]) * fx) * fy) / 255;
  };
  const auto at = [&](int64_t row, int64_t column) { return &image.texels[2 * (row * image.width + column)]; };
  if (i >= 0 && j >= 0 && i + 1 < image.width && j + 1 < image.height)
    return blend(at(j, i), at(j, i + 1), at(j + 1, i), at(j + 1, i + 1));
  const int column[2] = {wrapped(i, image.width, image.wrap_u), wrapped(i + 1, image.width, image.wrap_u)};
  const int row[2] = {wrapped(j, image.height, image.wrap_v), wrapped(j + 1, image.height, image.wrap_v)};
  blend(at(row[0], column[0]), at(row[0], column[1]), at(row[1], column[0]), at(row[1], column[1]));
}

void Rays::aim(Vec3 from, const std::vector<Vec3>& samples) {
  origin = from;
  count = static_cast<int>(samples.size());
  x.clear(), y.clear(), z.clear();
  for (const Vec3& s : samples) x.push_back(s.x - from.x), y.push_back(s.y - from.y), z.push_back(s.z - from.z);
  low.assign(samples.size(), 0);
  high.assign(samples.size(), kHuge);
  back = normalized(from);
  const Vec3 least = std::abs(back.x) < 0.6f ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
  right = normalized(cross(least, back));
  up = cross(back, right);
  pad_and_bound();
}

void Rays::pad_and_bound() {
  const int blocks = (count + kBlock - 1) / kBlock;
  bounds.assign(4 * static_cast<size_t>(blocks), 0);
  all[0] = all[2] = kHuge, all[1] = all[3] = -kHuge;
  for (auto* column : {&x, &y, &z, &low, &high})
    column->resize(static_cast<size_t>(blocks) * kBlock, column->empty() ? 0 : column->back());
  for (int b = 0; b < blocks; ++b) {
    float* range = &bounds[4 * static_cast<size_t>(b)];
    range[0] = range[2] = kHuge, range[1] = range[3] = -kHuge;
    for (int i = b * kBlock; i < std::min(count, (b + 1) * kBlock); ++i) {
      const Vec3 d{x[i], y[i], z[i]};
      const float depth = -dot(d, back);
      const float across = depth > 1e-3f ? dot(d, right) / depth : 0, above = depth > 1e-3f ? dot(d, up) / depth : 0;
      const bool behind = !(depth > 1e-3f);
      range[0] = std::min(range[0], behind ? -kHuge : across), range[1] = std::max(range[1], behind ? kHuge : across);
      range[2] = std::min(range[2], behind ? -kHuge : above), range[3] = std::max(range[3], behind ? kHuge : above);
    }
    for (int k = 0; k < 4; ++k) all[k] = k % 2 ? std::max(all[k], range[k]) : std::min(all[k], range[k]);
  }
}

void Rays::within(float radius) {
  const float beyond = dot(origin, origin) - radius * radius;
  for (size_t i = 0; i < x.size(); ++i) {
    const Vec3 d{x[i], y[i], z[i]};
    const float a = dot(d, d), b = dot(origin, d), under = b * b - a * beyond;
    const float root = under > 0 ? std::sqrt(under) : 0;
    const float enter = (-b - root) / a, leave = (-b + root) / a;
    high[i] = enter > 0 ? 1 / enter : kHuge;
    low[i] = under > 0 && leave > 0 ? 1 / leave : kHuge;
  }
}

void Caster::cast(const Rays& rays, Patch& patch) {
  if (patch.four.empty()) patch.pack();
  const int count = patch.size(), blocks = static_cast<int>(rays.bounds.size() / 4);
  planes_.clear(), bounds_.clear(), usable_.clear();
  Lanes range[4];
  Mask outside{};
  for (int t = 0; t < count; ++t) {
    if (t % 4 == 0) outside = bound(rays, &patch.four[9 * static_cast<size_t>(t / 4)], range);
    if (outside[t % 4]) continue;
    const Vec3 *corner = &patch.x[3 * static_cast<size_t>(t)], o = rays.origin;
    const Vec3 a = corner[0] - o, b = corner[1] - o, c = corner[2] - o;
    Plane plane;
    // b × c = b × (c − b): differences first keep the digits of small triangles
    plane.n[0] = cross(b, corner[2] - corner[1]);
    plane.n[1] = cross(c, corner[0] - corner[2]);
    plane.n[2] = cross(a, corner[1] - corner[0]);
    const float volume = dot(a, plane.n[0]);
    if (!(std::abs(volume) > 1e-20f)) continue;
    if (volume < 0)
      for (Vec3& n : plane.n) n = n * -1.0f;
    plane.per_volume = 1 / std::abs(volume);
    planes_.push_back(plane);
    for (const Lanes& lanes : range) bounds_.push_back(lanes[t % 4]);
    usable_.push_back(t);
  }
  inverse_.resize(rays.x.size());
  triangle_.resize(rays.x.size());
  constexpr int kWide = kBlock / 4;
  for (int block = 0; block < blocks; ++block) {
    const size_t start = static_cast<size_t>(block) * kBlock;
    const float* range = &rays.bounds[4 * static_cast<size_t>(block)];
    Lanes best[kWide], dx[kWide], dy[kWide], dz[kWide], high[kWide];
    Mask found[kWide];
    for (int k = 0; k < kWide; ++k) {
      const auto load = [&](const std::vector<float>& from) {
        Lanes lanes;
        std::memcpy(&lanes, &from[start + 4 * static_cast<size_t>(k)], sizeof lanes);
        return lanes;
      };
      best[k] = load(rays.low), high[k] = load(rays.high), dx[k] = load(rays.x), dy[k] = load(rays.y), dz[k] = load(rays.z);
      found[k] = Mask{-1, -1, -1, -1};
    }
    for (size_t t = 0; t < planes_.size(); ++t) {
      const float* other = &bounds_[4 * t];
      if (other[0] > range[1] || other[1] < range[0] || other[2] > range[3] || other[3] < range[2]) continue;
      const Plane& plane = planes_[t];
      for (int k = 0; k < kWide; ++k) {
        const Lanes u = plane.n[0].x * dx[k] + plane.n[0].y * dy[k] + plane.n[0].z * dz[k];
        const Lanes v = plane.n[1].x * dx[k] + plane.n[1].y * dy[k] + plane.n[1].z * dz[k];
        const Lanes w = plane.n[2].x * dx[k] + plane.n[2].y * dy[k] + plane.n[2].z * dz[k];
        const Lanes sum = u + v + w, inverse = sum * plane.per_volume, least = -kEdgeTolerance * sum;
        const Mask hit = (u >= least) & (v >= least) & (w >= least) & (inverse > best[k]) & (inverse <= high[k]);
        best[k] = hit ? inverse : best[k];
        found[k] = hit ? Mask{} + static_cast<int>(t) : found[k];
      }
    }
    for (int k = 0; k < kWide; ++k)
      for (int lane = 0; lane < 4; ++lane) {
        const size_t i = start + static_cast<size_t>(4 * k + lane);
        triangle_[i] = found[k][lane];
        inverse_[i] = best[k][lane];
      }
  }
}

Hit Caster::hit(const Rays& rays, const Patch& patch, int ray) const {
  Hit hit;
  const int32_t row = triangle_[ray];
  if (row < 0) return hit;
  hit.triangle = usable_[row];
  hit.inverse = inverse_[ray];
  // once more in doubles: grazing rays lose digits
  const auto wide = [](Vec3 x) { return Point{x.x, x.y, x.z}; };
  const Point d = wide({rays.x[ray], rays.y[ray], rays.z[ray]}), o = wide(rays.origin);
  const Vec3* corner = &patch.x[3 * static_cast<size_t>(hit.triangle)];
  const Point a = wide(corner[0]) - o, b = wide(corner[1]) - o, c = wide(corner[2]) - o;
  const double u = dot(cross(b, c), d), v = dot(cross(c, a), d), w = dot(cross(a, b), d), over = 1 / (u + v + w);
  hit.weights[0] = static_cast<float>(u * over), hit.weights[1] = static_cast<float>(v * over);
  hit.weights[2] = static_cast<float>(w * over);
  return hit;
}

float colour(const Shading& shading, const Patch& patch, const Hit& hit, Vec3 direction, float missing) {
  const Corner* c = &patch.corners[3 * static_cast<size_t>(hit.triangle)];
  const float *w = hit.weights;
  const auto blend = [&](auto field) { return w[0] * field(c[0]) + w[1] * field(c[1]) + w[2] * field(c[2]); };
  Vec3 n{blend([](const Corner& k) { return k.n[0]; }), blend([](const Corner& k) { return k.n[1]; }),
         blend([](const Corner& k) { return k.n[2]; })};
  if (!(dot(n, n) > 1e-12f)) {
    const Vec3* x = &patch.x[3 * static_cast<size_t>(hit.triangle)];
    n = cross(x[1] - x[0], x[2] - x[0]);
  }
  // lit from both sides: which way a face is wound does not tell which side is looked at in every model
  const float length = std::sqrt(dot(n, n) * dot(direction, direction));
  const float facing = length > 0 ? std::abs(dot(n, direction)) / length : 0;
  const Look& look = shading.look(patch.look[hit.triangle]);
  float texel[2];
  shading.texel(look, blend([](const Corner& k) { return k.u; }), blend([](const Corner& k) { return k.v; }), texel);
  const float luminance = texel[0] * look.luminance * blend([](const Corner& k) { return k.tint; });
  float alpha = texel[1] * look.alpha * blend([](const Corner& k) { return k.alpha; });
  if (look.cutoff >= 0) alpha = alpha >= look.cutoff ? 1.0f : 0.0f;
  const float lit = std::clamp(luminance, 0.0f, 1.0f) * std::min(facing, 1.0f);
  alpha = std::clamp(alpha, 0.0f, 1.0f);
  return alpha * lit + (1 - alpha) * missing;
}

}  // namespace lodpipe::similarity
