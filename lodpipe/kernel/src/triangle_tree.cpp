#include "triangle_tree.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "order.h"
#include "parallel.h"

namespace lodpipe {

namespace {

using Point = TriangleTree::Point;

constexpr int kGrain = 512;       // points that a thread takes at once
constexpr float kSlack = 1.000002f;  // covers the rounding of a box's squared distance in single precision

uint64_t spread(uint64_t v) {  // 21 bits to every third place
  v = (v | v << 32) & 0x1F00000000FFFFull;
  v = (v | v << 16) & 0x1F0000FF0000FFull;
  v = (v | v << 8) & 0x100F00F00F00F00Full;
  v = (v | v << 4) & 0x10C30C30C30C30C3ull;
  return (v | v << 2) & 0x1249249249249249ull;
}

Point point(const float* p) { return {p[0], p[1], p[2]}; }

Point on_segment(Point p, Point a, Point b) {
  const Point along = b - a;
  const double square = dot(along, along);
  const double t = square > 0 ? std::clamp(dot(p - a, along) / square, 0.0, 1.0) : 0.0;
  return a + along * t;
}

// Ericson 2005, "Real-Time Collision Detection", 5.1.5; a triangle without area is its edges.
Point on_triangle(Point p, Point a, Point b, Point c) {
  const Point ab = b - a, ac = c - a, ap = p - a;
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return a;
  const Point bp = p - b;
  const double d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 > d3) return a + ab * (d1 / (d1 - d3));
  const Point cp = p - c;
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0 && d2 > d6) return a + ac * (d2 / (d2 - d6));
  const double va = d3 * d6 - d5 * d4, up = d4 - d3, down = d5 - d6;
  if (va <= 0 && up >= 0 && down >= 0 && up + down > 0) return b + (c - b) * (up / (up + down));
  const double whole = va + vb + vc;
  if (whole > 0) return a + ab * (vb / whole) + ac * (vc / whole);
  Point best = on_segment(p, a, b);
  for (const Point q : {on_segment(p, b, c), on_segment(p, c, a)})
    if (dot(p - q, p - q) < dot(p - best, p - best)) best = q;
  return best;
}

}  // namespace

TriangleTree::TriangleTree(const float* positions, const int32_t* faces, int count) {
  if (!count) return;
  std::vector<Keyed> order(count);
  {
    std::vector<Point> middle(count);
    Point low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
    for (int f = 0; f < count; ++f) {
      const Point a = point(positions + 3 * faces[3 * f]), b = point(positions + 3 * faces[3 * f + 1]),
                  c = point(positions + 3 * faces[3 * f + 2]);
      const auto half = [](double x, double y, double z) { return std::min({x, y, z}) / 2 + std::max({x, y, z}) / 2; };
      const Point m = middle[f] = {half(a.x, b.x, c.x), half(a.y, b.y, c.y), half(a.z, b.z, c.z)};
      low = {std::min(low.x, m.x), std::min(low.y, m.y), std::min(low.z, m.z)};
      high = {std::max(high.x, m.x), std::max(high.y, m.y), std::max(high.z, m.z)};
    }
    const Point size = high - low;
    const double extent = std::max({size.x, size.y, size.z}), scale = extent > 0 ? ((1 << 21) - 1) / extent : 0.0;
    for (int f = 0; f < count; ++f) {
      const Point at = (middle[f] - low) * scale;
      order[f] = {spread(static_cast<uint64_t>(at.x)) << 2 | spread(static_cast<uint64_t>(at.y)) << 1 |
                      spread(static_cast<uint64_t>(at.z)),
                  f};
    }
  }
  {
    decltype(order) scratch;
    radix_sort(order, scratch);
  }
  corners_.resize(9 * static_cast<size_t>(count));
  face_.resize(count);
  row_.resize(count);
  for (int i = 0; i < count; ++i) {
    const int32_t f = face_[i] = order[i].id;
    row_[f] = i;
    for (int k = 0; k < 3; ++k)
      std::copy_n(positions + 3 * static_cast<size_t>(faces[3 * f + k]), 3, &corners_[9 * static_cast<size_t>(i) + 3 * k]);
  }
  nodes_.reserve(count / kLeaf + 1);
  nodes_.emplace_back();
  build(order, 0, count, 0);
}

// Where the highest bit in which the keys differ turns to 1; the middle where they are equal.
int TriangleTree::split(const std::vector<Keyed>& order, int begin, int end) const {
  const uint64_t differ = order[begin].key ^ order[end - 1].key;
  if (!differ) return begin + (end - begin) / 2;
  const uint64_t bit = std::bit_floor(differ);
  return static_cast<int>(std::partition_point(order.begin() + begin, order.begin() + end,
                                               [bit](const Keyed& k) { return !(k.key & bit); }) -
                          order.begin());
}

TriangleTree::Box TriangleTree::bounds(int begin, int end) const {
  constexpr float big = std::numeric_limits<float>::infinity();
  Box box{{big, big, big}, {-big, -big, -big}};
  for (size_t i = 9 * static_cast<size_t>(begin); i < 9 * static_cast<size_t>(end); i += 3)
    for (int k = 0; k < 3; ++k) {
      box.low[k] = std::min(box.low[k], corners_[i + k]);
      box.high[k] = std::max(box.high[k], corners_[i + k]);
    }
  return box;
}

TriangleTree::Box TriangleTree::build(const std::vector<Keyed>& order, int begin, int end, int32_t at) {
  int cuts[kWide + 1] = {begin, end}, parts = 1;
  while (parts < kWide) {  // the largest part is split, until there are four or all are leaves
    int largest = 0;
    for (int i = 1; i < parts; ++i)
      if (cuts[i + 1] - cuts[i] > cuts[largest + 1] - cuts[largest]) largest = i;
    if (cuts[largest + 1] - cuts[largest] <= kLeaf) break;
    const int cut = split(order, cuts[largest], cuts[largest + 1]);
    std::copy_backward(cuts + largest + 1, cuts + parts + 1, cuts + parts + 2);
    cuts[largest + 1] = cut;
    ++parts;
  }
  constexpr float big = std::numeric_limits<float>::infinity();
  Box all{{big, big, big}, {-big, -big, -big}};
  for (int i = 0; i < kWide; ++i) {
    Box box{{big, big, big}, {big, big, big}};  // a place that is not taken is infinitely far
    int32_t child = 0, size = 0;
    if (i < parts) {
      const int from = cuts[i], to = cuts[i + 1];
      if (to - from <= kLeaf) {
        child = from;
        size = to - from;
        box = bounds(from, to);
      } else {
        child = static_cast<int32_t>(nodes_.size());
        nodes_.emplace_back();
        box = build(order, from, to, child);
      }
      for (int k = 0; k < 3; ++k) all.low[k] = std::min(all.low[k], box.low[k]), all.high[k] = std::max(all.high[k], box.high[k]);
    }
    Node& node = nodes_[at];
    node.child[i] = child;
    node.size[i] = size;
    for (int k = 0; k < 3; ++k) node.low[k][i] = box.low[k], node.high[k][i] = box.high[k];
  }
  return all;
}

inline void TriangleTree::try_triangle(int32_t row, Point p, Found& best) const {
  const float* t = &corners_[9 * static_cast<size_t>(row)];
  const Point q = on_triangle(p, point(t), point(t + 3), point(t + 6)), to = p - q;
  const double square = dot(to, to);
  if (square < best.square || (square == best.square && face_[row] < best.face)) best = {square, face_[row], q};
}

TriangleTree::Found TriangleTree::nearest(Point p, const float* single, int32_t hint) const {
  struct Entry {
    float square;
    int32_t child, size;
  };
  Found best{std::numeric_limits<double>::infinity(), std::numeric_limits<int32_t>::max(), {}};
  try_triangle(hint, p, best);
  Entry stack[kDepth];
  int depth = 0;
  stack[depth++] = {0, 0, 0};
  while (depth) {
    const Entry entry = stack[--depth];
    if (entry.square > static_cast<float>(best.square) * kSlack) continue;
    if (entry.size) {
      for (int32_t i = entry.child; i < entry.child + entry.size; ++i) try_triangle(i, p, best);
      continue;
    }
    const Node& node = nodes_[entry.child];
    float square[kWide] = {};
    for (int k = 0; k < 3; ++k)
      for (int i = 0; i < kWide; ++i) {
        const float off = std::max(std::max(node.low[k][i] - single[k], single[k] - node.high[k][i]), 0.0f);
        square[i] += off * off;
      }
    const float limit = static_cast<float>(best.square) * kSlack;
    const int bottom = depth;
    for (int i = 0; i < kWide; ++i) {
      if (!(square[i] <= limit) || square[i] == std::numeric_limits<float>::infinity()) continue;
      int at = depth++;
      for (; at > bottom && stack[at - 1].square < square[i]; --at) stack[at] = stack[at - 1];  // the nearest on top
      stack[at] = {square[i], node.child[i], node.size[i]};
    }
  }
  return best;
}

void TriangleTree::closest(const float* points, int count, int threads, double* distance, double* found,
                           int32_t* face) const {
  if (face_.empty()) return;
  Pool pool(std::min(threads, (count + kGrain - 1) / kGrain));
  pool.range(count, kGrain, [&](int begin, int end) {
    int32_t hint = 0;  // neighbours in the list mostly are neighbours in space
    for (int i = begin; i < end; ++i) {
      const float* p = points + 3 * static_cast<size_t>(i);
      const Found best = nearest(point(p), p, hint);
      distance[i] = std::sqrt(best.square);
      face[i] = best.face;
      found[3 * static_cast<size_t>(i)] = best.point.x;
      found[3 * static_cast<size_t>(i) + 1] = best.point.y;
      found[3 * static_cast<size_t>(i) + 2] = best.point.z;
      hint = row_[best.face];
    }
  });
}

int32_t TriangleTree::facing(Point p, Point n, double reach) const {
  int32_t best = -1, stack[kDepth];
  int depth = 0;
  stack[depth++] = 0;
  const double origin[3] = {p.x, p.y, p.z}, along[3] = {n.x, n.y, n.z};
  while (depth) {
    const Node& node = nodes_[stack[--depth]];
    for (int i = 0; i < kWide; ++i) {
      double from = -reach, to = reach;
      for (int k = 0; k < 3; ++k) {
        const double low = node.low[k][i] - origin[k], high = node.high[k][i] - origin[k];
        if (along[k] == 0) {
          if (low > 0 || high < 0) to = -std::numeric_limits<double>::infinity();
          continue;
        }
        const double x = low / along[k], y = high / along[k];
        from = std::max(from, std::min(x, y));
        to = std::min(to, std::max(x, y));
      }
      if (from > to + 1e-12) continue;
      if (!node.size[i]) {
        if (node.low[0][i] < std::numeric_limits<float>::infinity()) stack[depth++] = node.child[i];
        continue;
      }
      for (int32_t row = node.child[i]; row < node.child[i] + node.size[i]; ++row) {
        // Möller & Trumbore 1997, with the determinant's sign: that of the normals' product
        const float* t = &corners_[9 * static_cast<size_t>(row)];
        const Point a = point(t), ab = point(t + 3) - a, ac = point(t + 6) - a;
        const double product = dot(cross(ab, ac), n);
        if (!(product > 0)) continue;
        const Point to_a = p - a, q = cross(to_a, n);
        const double u = -dot(ac, q), v = dot(ab, q), slack = -1e-9 * product;
        if (u < slack || v < slack || u + v > product - slack) continue;
        const double away = std::abs(dot(cross(ab, ac), to_a) / product);
        if (away > reach || (away == reach && best >= 0 && face_[row] > best)) continue;
        reach = away;
        best = face_[row];
      }
    }
  }
  return best;
}

void TriangleTree::facing(const float* points, const double* normals, const double* reach, int count, int threads,
                          int32_t* face) const {
  if (face_.empty()) return std::fill_n(face, count, -1), void();
  Pool pool(std::min(threads, (count + kGrain - 1) / kGrain));
  pool.range(count, kGrain, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const double* n = normals + 3 * static_cast<size_t>(i);
      face[i] = facing(point(points + 3 * static_cast<size_t>(i)), {n[0], n[1], n[2]}, reach[i]);
    }
  });
}

}  // namespace lodpipe
