#include "sampling.h"

#include <numbers>

namespace lodpipe::similarity {

std::vector<Point> hemisphere(int count) {
  std::vector<Point> out;
  for (int i = 0; i < count; ++i) {
    const double height = 1 - (i + 0.5) / count, level = std::sqrt(1 - height * height);
    const double turn = std::numbers::pi * (1 + std::sqrt(5.0)) * (i + 0.5);
    out.push_back({level * std::cos(turn), level * std::sin(turn), height});
  }
  return out;
}

Frame::Frame(Point axis) : w(axis) {
  const double sign = std::copysign(1.0, axis.z), a = -1 / (sign + axis.z), b = axis.x * axis.y * a;
  u = {1 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x};
  v = {b, sign + axis.y * axis.y * a, -axis.y};
}

void scan_lines(Point a, Point b, Point c, double step, std::vector<Vec3>& out) {
  const Point ab = b - a, ac = c - a, normal = cross(ab, ac);
  const double width = length(ab), doubled = length(normal);
  if (!(doubled > 1e-12 * (dot(ab, ab) + dot(ac, ac)))) return;
  const Point i = ab * (1 / width), j = cross(normal * (1 / doubled), i);
  const double height = doubled / width, across = dot(ac, i);
  const Point middle = (a + b + c) * (1.0 / 3);
  const double slack = 1e-9 * step;
  for (int line = 0; line * step <= height + slack; ++line) {
    const double y = line * step, part = y / height;
    const double left = across * part, right = width + (across - width) * part;
    for (int column = 0; left + column * step <= right + slack; ++column) {
      const Point at = a + i * (left + column * step) + j * y;
      const Point x = middle + (at - middle) * kInset;
      out.push_back({static_cast<float>(x.x), static_cast<float>(x.y), static_cast<float>(x.z)});
    }
  }
}

}  // namespace lodpipe::similarity
