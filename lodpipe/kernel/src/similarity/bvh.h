// Boxes in a tree: which triangles of the original mesh come near a sphere.
#pragma once
#include <algorithm>
#include <vector>

#include "vector.h"

namespace lodpipe::similarity {

class BoxTree {
 public:
  struct Box {
    Point low{1e308, 1e308, 1e308}, high{-1e308, -1e308, -1e308};
    void add(Point p) {
      low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
      high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
    }
    double square_distance(Point p) const {
      const auto off = [](double x, double a, double b) { return x < a ? a - x : x > b ? x - b : 0.0; };
      const Point d{off(p.x, low.x, high.x), off(p.y, low.y, high.y), off(p.z, low.z, high.z)};
      return dot(d, d);
    }
  };

  explicit BoxTree(std::vector<Box> boxes) : boxes_(std::move(boxes)), order_(boxes_.size()) {
    for (size_t i = 0; i < order_.size(); ++i) order_[i] = static_cast<int32_t>(i);
    if (!order_.empty()) build(0, static_cast<int32_t>(order_.size()));
  }

  // Adds the numbers of the boxes that meet the sphere.
  void near(Point center, double radius, std::vector<int32_t>& out) const {
    if (nodes_.empty()) return;
    const double square = radius * radius;
    int32_t stack[64], depth = 0;
    stack[depth++] = 0;
    while (depth) {
      const Node& node = nodes_[stack[--depth]];
      if (node.box.square_distance(center) > square) continue;
      if (node.right) {
        stack[depth++] = node.right;
        stack[depth++] = static_cast<int32_t>(&node - nodes_.data()) + 1;
        continue;
      }
      for (int32_t i = node.begin; i < node.end; ++i)
        if (boxes_[order_[i]].square_distance(center) <= square) out.push_back(order_[i]);
    }
  }

 private:
  struct Node {
    Box box;
    int32_t begin, end, right;  // the left child follows; right = 0: a leaf
  };
  static constexpr int kLeaf = 4;

  void build(int32_t begin, int32_t end) {
    const size_t at = nodes_.size();
    nodes_.push_back({{}, begin, end, 0});
    Box box;
    for (int32_t i = begin; i < end; ++i) box.add(boxes_[order_[i]].low), box.add(boxes_[order_[i]].high);
    nodes_[at].box = box;
    if (end - begin <= kLeaf) return;
    const Point size = box.high - box.low;
    const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
    const auto middle = [&](int32_t i) {
      const Box& b = boxes_[i];
      return axis == 0 ? b.low.x + b.high.x : axis == 1 ? b.low.y + b.high.y : b.low.z + b.high.z;
    };
    const int32_t half = begin + (end - begin) / 2;  // halves: the depth is the logarithm, whatever the input
    std::nth_element(order_.begin() + begin, order_.begin() + half, order_.begin() + end, [&](int32_t a, int32_t b) {
      const double x = middle(a), y = middle(b);
      return x != y ? x < y : a < b;
    });
    build(begin, half);
    nodes_[at].right = static_cast<int32_t>(nodes_.size());
    build(half, end);
  }

  std::vector<Box> boxes_;
  std::vector<int32_t> order_;
  std::vector<Node> nodes_;
};

}  // namespace lodpipe::similarity
