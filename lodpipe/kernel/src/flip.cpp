#include "flip.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include "srgb.h"

namespace lodpipe {

namespace {

using Plane = std::vector<float>;

// The paper's constants, by its names: section 4.1 (q_c, p_c, p_t) and 4.2 (w, q_f).
constexpr double kExponent = 0.7, kKnee = 0.4, kKneeTo = 0.95, kFeatureWidth = 0.082;

// Linear RGB to XYZ, and the white of (1, 1, 1).
constexpr double kXyz[3][3] = {{0.41238656, 0.35759149, 0.18045049},
                               {0.21263682, 0.71518298, 0.07218020},
                               {0.01933062, 0.11919716, 0.95037259}};

struct Matrix {
  float m[3][3];
  std::array<float, 3> operator()(float x, float y, float z) const {
    return {m[0][0] * x + m[0][1] * y + m[0][2] * z, m[1][0] * x + m[1][1] * y + m[1][2] * z,
            m[2][0] * x + m[2][1] * y + m[2][2] * z};
  }
};

// RGB to XYZ over the white's, and back.
struct Space {
  Matrix to, back;
  Space() {
    double n[3][3];
    for (int i = 0; i < 3; ++i) {
      const double white = kXyz[i][0] + kXyz[i][1] + kXyz[i][2];
      for (int j = 0; j < 3; ++j) n[i][j] = kXyz[i][j] / white;
    }
    const auto minor = [&](int i, int j) {
      const int r = (i + 1) % 3, s = (i + 2) % 3, u = (j + 1) % 3, v = (j + 2) % 3;
      return n[r][u] * n[s][v] - n[r][v] * n[s][u];
    };
    const double det = n[0][0] * minor(0, 0) + n[0][1] * minor(0, 1) + n[0][2] * minor(0, 2);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        to.m[i][j] = static_cast<float>(n[i][j]);
        back.m[j][i] = static_cast<float>(minor(i, j) / det);
      }
  }
};

// The cube root of a number ≥ 0, to about 1e-7 of it.
inline float cube_root(float x) {
  float y = std::bit_cast<float>(std::bit_cast<uint32_t>(x) / 3 + 709921077u);
  for (int step = 0; step < 2; ++step) {  // Halley's
    const float cube = y * y * y;
    y *= (cube + 2 * x) / (2 * cube + x + 1e-30f);
  }
  return y;
}

// L*a*b* of XYZ over the white's, a and b scaled by the lightness as Hunt found colours to fade in the dark.
inline std::array<float, 3> lab(const std::array<float, 3>& xyz) {
  float f[3];
  for (int k = 0; k < 3; ++k) {
    constexpr float kEdge = 6.0f / 29.0f;
    const float t = xyz[k];
    f[k] = t > kEdge * kEdge * kEdge ? cube_root(t) : t / (3 * kEdge * kEdge) + 4.0f / 29.0f;
  }
  const float lightness = 116 * f[1] - 16, fade = 0.01f * lightness;
  return {lightness, fade * 500 * (f[0] - f[1]), fade * 200 * (f[1] - f[2])};
}

inline float distance(const std::array<float, 3>& a, const std::array<float, 3>& b) {  // HyAB
  const float p = a[1] - b[1], q = a[2] - b[2];
  return std::abs(a[0] - b[0]) + std::sqrt(p * p + q * q);
}

// A filter's taps −radius … radius.
using Taps = std::vector<float>;

Taps gaussian(double deviation, int radius, int derivative = 0) {
  std::vector<double> taps;
  double up = 0, down = 0;
  for (int x = -radius; x <= radius; ++x) {
    const double u = x / deviation, g = std::exp(-0.5 * u * u);
    taps.push_back(derivative == 0 ? g : derivative == 1 ? -u * g : (u * u - 1) * g);
    (taps.back() > 0 ? up : down) += std::abs(taps.back());
  }
  Taps scaled;  // what is above 0 sums to 1, and what is below to −1
  for (double tap : taps) scaled.push_back(static_cast<float>(tap / (tap > 0 ? up : down)));
  return scaled;
}

// A picture's filters along a row and along a column; beyond the border lies the border's pixel.
class Filter {
 public:
  Filter(int height, int width) : height_(height), width_(width) {}

  void rows(const Plane& in, const Taps& taps, Plane& out) const {
    const int radius = static_cast<int>(taps.size()) / 2;
    Plane wide(width_ + 2 * radius);
    out.assign(in.size(), 0);
    for (int y = 0; y < height_; ++y) {
      const float* row = in.data() + static_cast<size_t>(y) * width_;
      std::fill_n(wide.begin(), radius, row[0]);
      std::copy_n(row, width_, wide.begin() + radius);
      std::fill_n(wide.begin() + radius + width_, radius, row[width_ - 1]);
      add(wide.data(), 1, taps, out.data() + static_cast<size_t>(y) * width_);
    }
  }

  void columns(const Plane& in, const Taps& taps, Plane& out) const {
    const int radius = static_cast<int>(taps.size()) / 2;
    out.assign(in.size(), 0);
    for (int y = 0; y < height_; ++y) {
      float* to = out.data() + static_cast<size_t>(y) * width_;
      for (int k = -radius; k <= radius; ++k) {
        const float* from = in.data() + static_cast<size_t>(std::clamp(y + k, 0, height_ - 1)) * width_;
        const float tap = taps[k + radius];
        for (int x = 0; x < width_; ++x) to[x] += tap * from[x];
      }
    }
  }

 private:
  void add(const float* from, int step, const Taps& taps, float* to) const {
    for (float tap : taps) {
      for (int x = 0; x < width_; ++x) to[x] += tap * from[x];
      from += step;
    }
  }

  int height_, width_;
};

// Contrast sensitivity as a Gaussian of variance b / 2π², in degrees (table 1): b, and the weight in the kernel's sum.
struct Bell {
  double weight, b;
};

// A sum of bells, each of them separable, together scaled to a sum of 1.
void blur(const Filter& filter, Plane& plane, const std::vector<Bell>& bells, double density, int radius) {
  double total = 0;
  std::vector<std::pair<Taps, double>> parts;
  for (const Bell& bell : bells) {
    const double deviation = std::sqrt(bell.b / 2) / std::numbers::pi * density;
    double sum = 0;
    for (int x = -radius; x <= radius; ++x) sum += std::exp(-0.5 * x * x / (deviation * deviation));
    const double part = bell.weight * std::sqrt(std::numbers::pi / bell.b) * sum * sum;
    const int reach = std::min(radius, static_cast<int>(std::ceil(6 * deviation)));  // beyond: below 1e-7
    parts.emplace_back(gaussian(deviation, reach), part);
    total += part;
  }
  Plane across, along, sum(plane.size(), 0.0f);
  for (auto& [taps, part] : parts) {
    filter.rows(plane, taps, across);
    filter.columns(across, taps, along);
    const float share = static_cast<float>(part / total);
    for (size_t i = 0; i < sum.size(); ++i) sum[i] += share * along[i];
  }
  plane.swap(sum);
}

// What is compared of a picture: colours as seen at the distance, and how much of an edge and of a point each pixel is.
struct Look {
  std::vector<std::array<float, 3>> colours;
  Plane edges, points;
};

Look look(const float* picture, int height, int width, double density, const Space& space) {
  const size_t count = static_cast<size_t>(height) * width;
  const Filter filter(height, width);
  const Srgb& curve = Srgb::curve();
  std::array<Plane, 3> planes{Plane(count), Plane(count), Plane(count)};  // YCxCz
  for (size_t i = 0; i < count; ++i) {
    const float* p = picture + 3 * i;
    const auto [x, y, z] = space.to(curve.decoded(p[0]), curve.decoded(p[1]), curve.decoded(p[2]));
    planes[0][i] = 116 * y - 16, planes[1][i] = 500 * (x - y), planes[2][i] = 200 * (y - z);
  }
  Look seen{std::vector<std::array<float, 3>>(count), Plane(count), Plane(count)};

  const double deviation = 0.5 * kFeatureWidth * density;
  const int reach = static_cast<int>(std::ceil(3 * deviation));
  const Taps smooth = gaussian(deviation, reach), first = gaussian(deviation, reach, 1);
  const Taps second = gaussian(deviation, reach, 2);
  Plane grey(count), blurred, turned, x, y;
  for (size_t i = 0; i < count; ++i) grey[i] = (planes[0][i] + 16) / 116;
  filter.rows(grey, smooth, blurred);
  for (const auto& [taps, out] : {std::pair{&first, &seen.edges}, std::pair{&second, &seen.points}}) {
    filter.rows(grey, *taps, turned);
    filter.columns(turned, smooth, x);
    filter.columns(blurred, *taps, y);
    for (size_t i = 0; i < count; ++i) (*out)[i] = std::sqrt(x[i] * x[i] + y[i] * y[i]);
  }

  const int radius = static_cast<int>(std::ceil(3 * std::sqrt(0.04 / 2) / std::numbers::pi * density));
  blur(filter, planes[0], {{1, 0.0047}}, density, radius);
  blur(filter, planes[1], {{1, 0.0053}}, density, radius);
  blur(filter, planes[2], {{34.1, 0.04}, {13.5, 0.025}}, density, radius);
  for (size_t i = 0; i < count; ++i) {
    const float lightness = (planes[0][i] + 16) / 116;
    auto rgb = space.back(lightness + planes[1][i] / 500, lightness, lightness - planes[2][i] / 200);
    for (float& c : rgb) c = std::clamp(c, 0.0f, 1.0f);
    seen.colours[i] = lab(space.to(rgb[0], rgb[1], rgb[2]));
  }
  return seen;
}

}  // namespace

void flip(const float* a, const float* b, int height, int width, double density, float* out) {
  if (!height || !width) return;
  const Space space;
  const Look p = look(a, height, width, density, space), q = look(b, height, width, density, space);
  const float exponent = kExponent, largest = std::pow(distance(lab(space.to(0, 1, 0)), lab(space.to(0, 0, 1))), exponent);
  const float knee = kKnee * largest, to = kKneeTo;
  for (size_t i = 0; i < static_cast<size_t>(height) * width; ++i) {
    const float apart = distance(p.colours[i], q.colours[i]);
    const float feature = std::max(std::abs(p.edges[i] - q.edges[i]), std::abs(p.points[i] - q.points[i]));
    if (apart == 0) {
      out[i] = 0;
      continue;
    }
    const float colour = std::pow(apart, exponent);
    const float scaled = colour < knee ? colour * (to / knee) : to + (colour - knee) / (largest - knee) * (1 - to);
    const float differs = std::sqrt(feature * std::numbers::sqrt2_v<float> / 2);  // to the power q_f, ½
    out[i] = std::min(std::pow(scaled, 1 - std::min(differs, 1.0f)), 1.0f);
  }
}

}  // namespace lodpipe
