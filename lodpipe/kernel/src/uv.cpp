#include "uv.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <utility>

#include "parallel.h"

namespace lodpipe {
namespace {

struct Point {
  double x, y;
};
Point operator-(Point a, Point b) { return {a.x - b.x, a.y - b.y}; }
double cross(Point a, Point b) { return a.x * b.y - a.y * b.x; }
double dot(Point a, Point b) { return a.x * b.x + a.y * b.y; }
// Twice the signed area. The sign is right for coordinates that were single precision and of like size.
double orient(Point a, Point b, Point c) { return cross(b - a, c - a); }

struct Box {
  Point low{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
  Point high{-std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()};
  void add(Point p) {
    low = {std::min(low.x, p.x), std::min(low.y, p.y)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y)};
  }
  void add(const Box& b) {
    add(b.low);
    add(b.high);
  }
};
bool apart(const Box& a, const Box& b) {
  return a.high.x <= b.low.x || b.high.x <= a.low.x || a.high.y <= b.low.y || b.high.y <= a.low.y;
}
double distance(const Box& a, const Box& b) {
  const double x = std::max({a.low.x - b.high.x, b.low.x - a.high.x, 0.0});
  const double y = std::max({a.low.y - b.high.y, b.low.y - a.high.y, 0.0});
  return std::hypot(x, y);
}

// A binary tree of boxes, split at the median of the longer side: outliers and clusters do not slow it down.
class Tree {
 public:
  static constexpr int kLeaf = 4;
  struct Node {
    Box box;
    int begin, end, left;  // children are left and left + 1; −1: a leaf
  };

  Tree(const std::vector<Box>& boxes, std::vector<int> items) : items_(std::move(items)) {
    nodes_.reserve(items_.size());
    nodes_.push_back({{}, 0, static_cast<int>(items_.size()), -1});
    for (size_t at = 0; at < nodes_.size(); ++at) split(boxes, at);
    for (size_t at = nodes_.size(); at-- > 0;) {
      Node& n = nodes_[at];
      if (n.left >= 0) {
        n.box.add(nodes_[n.left].box);
        n.box.add(nodes_[n.left + 1].box);
      } else {
        for (int i = n.begin; i < n.end; ++i) n.box.add(boxes[items_[i]]);
      }
    }
  }

  // Calls visit(a, b) for each pair of items in leaves whose boxes near(box, box) holds for; false ends it.
  template <class Near, class Visit>
  void pairs(const Near& near, const Visit& visit) const {
    std::vector<std::pair<int, int>> todo{{0, 0}};
    while (!todo.empty()) {
      const auto [a, b] = todo.back();
      todo.pop_back();
      const Node &p = nodes_[a], &q = nodes_[b];
      if (a != b && !near(p.box, q.box)) continue;
      if (p.left < 0 && q.left < 0) {
        for (int i = p.begin; i < p.end; ++i)
          for (int j = a == b ? i + 1 : q.begin; j < q.end; ++j)
            if (!visit(items_[i], items_[j])) return;
      } else if (a == b) {
        todo.push_back({p.left, p.left + 1});
        todo.push_back({p.left + 1, p.left + 1});
        todo.push_back({p.left, p.left});
      } else if (q.left < 0 || (p.left >= 0 && p.end - p.begin >= q.end - q.begin)) {
        todo.push_back({p.left + 1, b});
        todo.push_back({p.left, b});
      } else {
        todo.push_back({a, q.left + 1});
        todo.push_back({a, q.left});
      }
    }
  }

 private:
  void split(const std::vector<Box>& boxes, size_t at) {
    const int begin = nodes_[at].begin, end = nodes_[at].end;
    if (end - begin <= kLeaf) return;
    Box centres;
    const auto centre = [&](int item) {
      const Box& b = boxes[item];
      return Point{b.low.x + b.high.x, b.low.y + b.high.y};
    };
    for (int i = begin; i < end; ++i) centres.add(centre(items_[i]));
    const bool by_x = centres.high.x - centres.low.x >= centres.high.y - centres.low.y;
    const int middle = (begin + end) / 2;
    std::nth_element(items_.begin() + begin, items_.begin() + middle, items_.begin() + end, [&](int a, int b) {
      const Point p = centre(a), q = centre(b);
      const double u = by_x ? p.x : p.y, v = by_x ? q.x : q.y;
      return u < v || (u == v && a < b);
    });
    nodes_[at].left = static_cast<int>(nodes_.size());
    nodes_.push_back({{}, begin, middle, -1});
    nodes_.push_back({{}, middle, end, -1});
  }

  std::vector<Node> nodes_;
  std::vector<int> items_;
};

using Triangle = std::array<Point, 3>;

Triangle triangle(const double* uv, int face) {
  const double* p = uv + 6 * static_cast<size_t>(face);
  return {Point{p[0], p[1]}, Point{p[2], p[3]}, Point{p[4], p[5]}};
}

Triangle counter_clockwise(Triangle t) {
  if (orient(t[0], t[1], t[2]) < 0) std::swap(t[1], t[2]);
  return t;
}

// Whether an edge of `a` has all of `b` on its outer side; both counter-clockwise.
bool separated(const Triangle& a, const Triangle& b) {
  for (int k = 0; k < 3; ++k) {
    const Point p = a[k], q = a[(k + 1) % 3];
    if (orient(p, q, b[0]) <= 0 && orient(p, q, b[1]) <= 0 && orient(p, q, b[2]) <= 0) return true;
  }
  return false;
}

// Area of what two counter-clockwise triangles have in common (Sutherland & Hodgman 1974); 0 where it is thinner
// than `slack`.
double common_area(const Triangle& a, const Triangle& b, double slack) {
  std::array<Point, 8> shape{a[0], a[1], a[2]}, next{};
  int count = 3;
  for (int k = 0; k < 3 && count; ++k) {
    const Point p = b[k], q = b[(k + 1) % 3];
    int made = 0;
    for (int i = 0; i < count; ++i) {
      const Point s = shape[i], e = shape[(i + 1) % count];
      const double from = orient(p, q, s), to = orient(p, q, e);
      if (from >= 0) next[made++] = s;
      if ((from > 0 && to < 0) || (from < 0 && to > 0)) {
        const double t = from / (from - to);
        next[made++] = {s.x + (e.x - s.x) * t, s.y + (e.y - s.y) * t};
      }
    }
    shape = next;
    count = made;
  }
  double doubled = 0, longest = 0;
  for (int i = 0; i < count; ++i) {
    doubled += orient(shape[0], shape[i], shape[(i + 1) % count]);
    const Point d = shape[i] - shape[0];
    longest = std::max(longest, dot(d, d));
  }
  return doubled > 2 * slack * std::sqrt(longest) ? doubled / 2 : 0;
}

// The items of each group, in order.
std::vector<std::vector<int>> by_group(const int32_t* group, int count) {
  std::vector<std::vector<int>> groups;
  for (int i = 0; i < count; ++i) {
    if (static_cast<size_t>(group[i]) >= groups.size()) groups.resize(group[i] + 1);
    groups[group[i]].push_back(i);
  }
  return groups;
}

double segment_distance(Point a, Point b, Point p) {
  const Point d = b - a;
  const double length = dot(d, d), t = length > 0 ? std::clamp(dot(p - a, d) / length, 0.0, 1.0) : 0;
  return std::hypot(a.x + d.x * t - p.x, a.y + d.y * t - p.y);
}

double segment_distance(Point a, Point b, Point c, Point d) {
  const double s = orient(a, b, c), t = orient(a, b, d), u = orient(c, d, a), v = orient(c, d, b);
  if (((s > 0 && t < 0) || (s < 0 && t > 0)) && ((u > 0 && v < 0) || (u < 0 && v > 0))) return 0;
  return std::min({segment_distance(a, b, c), segment_distance(a, b, d), segment_distance(c, d, a),
                   segment_distance(c, d, b)});
}

}  // namespace

std::vector<int32_t> chart_labels(const int32_t* faces, int count) {
  std::vector<std::pair<uint64_t, int32_t>> edges;
  edges.reserve(3 * static_cast<size_t>(count));
  for (int f = 0; f < count; ++f)
    for (int k = 0; k < 3; ++k) {
      const uint32_t a = faces[3 * f + k], b = faces[3 * f + (k + 1) % 3];
      if (a != b) edges.push_back({static_cast<uint64_t>(std::min(a, b)) << 32 | std::max(a, b), f});
    }
  std::sort(edges.begin(), edges.end());
  std::vector<int32_t> parent(count);
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int32_t f) {
    while (parent[f] != f) f = parent[f] = parent[parent[f]];
    return f;
  };
  for (size_t i = 1; i < edges.size(); ++i)
    if (edges[i].first == edges[i - 1].first) {
      const int32_t a = root(edges[i].second), b = root(edges[i - 1].second);
      parent[std::max(a, b)] = std::min(a, b);
    }
  std::vector<int32_t> label(count, -1);
  int32_t next = 0;
  for (int f = 0; f < count; ++f) {
    const int32_t r = root(f);
    label[f] = r == f ? next++ : label[r];  // a root is the lowest face of its chart
  }
  return label;
}

std::vector<int32_t> join_pairs(const int32_t* pairs, int count, int nodes) {
  std::vector<int32_t> parent(nodes);
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int32_t n) {
    while (parent[n] != n) n = parent[n] = parent[parent[n]];
    return n;
  };
  for (int i = 0; i < count; ++i) {
    const int32_t a = root(pairs[2 * i]), b = root(pairs[2 * i + 1]);
    parent[std::max(a, b)] = std::min(a, b);
  }
  for (int n = 0; n < nodes; ++n) parent[n] = root(n);
  return parent;
}

UvOverlaps uv_overlaps(const UvFaces& in, double slack, int64_t limit) {
  UvOverlaps out;
  out.faces.assign(in.count, 0);
  std::vector<Triangle> shapes(in.count);
  std::vector<uint8_t> turned(in.count);
  std::vector<Box> boxes(in.count);
  for (int f = 0; f < in.count; ++f) {
    const Triangle t = triangle(in.uv, f);
    turned[f] = orient(t[0], t[1], t[2]) < 0;
    shapes[f] = counter_clockwise(t);
    for (const Point& p : t) boxes[f].add(p);
  }
  std::map<std::pair<int32_t, int32_t>, std::array<double, 2>> found;
  int64_t tests = 0;
  for (std::vector<int>& items : by_group(in.group, in.count)) {
    if (items.size() < 2) continue;
    const Tree tree(boxes, std::move(items));
    tree.pairs([](const Box& a, const Box& b) { return !apart(a, b); },
               [&](int a, int b) {
                 if (apart(boxes[a], boxes[b])) return true;
                 if (++tests > limit) return out.complete = false;
                 if (separated(shapes[a], shapes[b]) || separated(shapes[b], shapes[a])) return true;
                 if (const double area = common_area(shapes[a], shapes[b], slack)) {
                   const auto key = std::minmax(in.chart[a], in.chart[b]);
                   found[{key.first, key.second}][turned[a] != turned[b]] += area;
                   out.faces[a] = out.faces[b] = 1;
                 }
                 return true;
               });
  }
  for (const auto& [key, area] : found) {
    out.charts.insert(out.charts.end(), {key.first, key.second});
    out.area.insert(out.area.end(), area.begin(), area.end());
  }
  return out;
}

std::vector<double> uv_coverage(const UvFaces& in, int groups, int lines) {
  constexpr double kCrossings = 2e7;
  std::vector<double> out(2 * static_cast<size_t>(groups), 0.0);
  const std::vector<std::vector<int>> members = by_group(in.group, in.count);
  for (size_t g = 0; g < members.size(); ++g) {
    double low = std::numeric_limits<double>::infinity(), high = -low, heights = 0;
    const auto extent = [&](const Triangle& t) { return std::minmax({t[0].y, t[1].y, t[2].y}); };
    for (int f : members[g]) {
      const auto [bottom, top] = extent(triangle(in.uv, f));
      low = std::min(low, bottom);
      high = std::max(high, top);
      heights += top - bottom;
    }
    if (!(high > low)) continue;
    const int count = static_cast<int>(std::clamp(kCrossings * (high - low) / heights, 64.0, double(lines)));
    const double step = (high - low) / count;
    const auto first_line = [&](double y) {  // the first one not below y
      return static_cast<int>(std::clamp(std::ceil((y - low) / step - 0.5), 0.0, double(count)));
    };
    std::vector<size_t> start(count + 1, 0);
    for (int f : members[g]) {
      const auto [bottom, top] = extent(triangle(in.uv, f));
      for (int line = first_line(bottom), end = first_line(top); line < end; ++line) ++start[line + 1];
    }
    std::partial_sum(start.begin(), start.end(), start.begin());
    std::vector<std::pair<double, int>> ends(2 * start.back());  // where a triangle begins (+1) and ends (−1)
    std::vector<size_t> at(start.begin(), start.end() - 1);
    for (int f : members[g]) {
      const Triangle t = triangle(in.uv, f);
      const auto [bottom, top] = extent(t);
      for (int line = first_line(bottom), end = first_line(top); line < end; ++line) {
        const double y = low + (line + 0.5) * step;
        double left = std::numeric_limits<double>::infinity(), right = -left;
        for (int k = 0; k < 3; ++k) {
          Point p = t[k], q = t[(k + 1) % 3];
          if (p.y > q.y) std::swap(p, q);
          if (y < p.y || y > q.y || p.y == q.y) continue;
          const double x = p.x + (q.x - p.x) * ((y - p.y) / (q.y - p.y));
          left = std::min(left, x);
          right = std::max(right, x);
        }
        if (!(left <= right)) left = right = t[0].x;
        const size_t place = 2 * at[line]++;
        ends[place] = {left, 1};
        ends[place + 1] = {right, -1};
      }
    }
    for (int line = 0; line < count; ++line) {
      const auto begin = ends.begin() + 2 * start[line], end = ends.begin() + 2 * start[line + 1];
      std::sort(begin, end);
      int depth = 0;
      for (auto e = begin; e != end; ++e) {
        if (e != begin) {
          const double length = (e->first - (e - 1)->first) * step;
          if (depth > 0) out[2 * g] += length;
          if (depth > 1) out[2 * g + 1] += length;
        }
        depth += e->second;
      }
    }
  }
  return out;
}

std::vector<double> uv_gaps(const double* segments, const int32_t* chart, const int32_t* group, int count, int groups,
                            double reach) {
  std::vector<double> best(groups, reach);
  std::vector<Box> boxes(count);
  const auto end = [&](int i, int k) { return Point{segments[4 * size_t(i) + 2 * k], segments[4 * size_t(i) + 2 * k + 1]}; };
  for (int i = 0; i < count; ++i) {
    boxes[i].add(end(i, 0));
    boxes[i].add(end(i, 1));
  }
  const std::vector<std::vector<int>> members = by_group(group, count);
  for (size_t g = 0; g < members.size(); ++g) {
    if (members[g].size() < 2) continue;
    double& least = best[g];
    const Tree tree(boxes, members[g]);
    tree.pairs([&](const Box& a, const Box& b) { return distance(a, b) < least; },
               [&](int a, int b) {
                 if (chart[a] != chart[b] && distance(boxes[a], boxes[b]) < least)
                   least = std::min(least, segment_distance(end(a, 0), end(a, 1), end(b, 0), end(b, 1)));
                 return least > 0;
               });
  }
  return best;
}

UvRaster uv_raster(const double* uv, int count, const int32_t* edges, int edge_count, int left, int top, int width,
                   int height, double reach, int threads) {
  constexpr int kBand = 64;
  UvRaster out;
  const size_t texels = static_cast<size_t>(width) * height;
  out.faces.assign(texels, -1);
  out.weights.assign(3 * texels, 0.0f);
  out.inside.assign(texels, 0);
  // The first and one past the last texel whose centre lies in [low, high], within [begin, end).
  const auto span = [](double low, double high, int begin, int end) {
    return std::pair(static_cast<int>(std::clamp(std::ceil(low - 0.5), double(begin), double(end))),
                     static_cast<int>(std::clamp(std::floor(high - 0.5) + 1, double(begin), double(end))));
  };
  const int bands = (height + kBand - 1) / kBand;
  // A list of the faces and edges that touch each band, so that a band does not look at all of them.
  std::vector<std::vector<int>> faces_of(bands), edges_of(bands);
  const auto enlist = [&](std::vector<std::vector<int>>& lists, double low, double high, int item) {
    const auto [from, to] = span(low, high, top, top + height);
    if (from >= to) return;
    for (int band = (from - top) / kBand; band <= (to - 1 - top) / kBand; ++band) lists[band].push_back(item);
  };
  for (int f = 0; f < count; ++f) {
    const Triangle t = triangle(uv, f);
    const auto [low, high] = std::minmax({t[0].y, t[1].y, t[2].y});
    enlist(faces_of, low, high, f);
  }
  for (int e = 0; e < edge_count; ++e) {
    const Triangle t = triangle(uv, edges[2 * e]);
    const auto [low, high] = std::minmax(t[edges[2 * e + 1]].y, t[(edges[2 * e + 1] + 1) % 3].y);
    enlist(edges_of, low - reach, high + reach, e);
  }
  Pool pool(std::min(threads, bands));
  pool.run(bands, [&](int band) {
    const int begin = top + band * kBand, end = std::min(begin + kBand, top + height);
    const auto at = [&](int x, int y) { return static_cast<size_t>(y - top) * width + (x - left); };
    const auto put = [&](size_t i, int face, double a, double b, double c) {
      out.faces[i] = face;
      out.weights[3 * i] = static_cast<float>(a);
      out.weights[3 * i + 1] = static_cast<float>(b);
      out.weights[3 * i + 2] = static_cast<float>(c);
    };
    for (int f : faces_of[band]) {
      const Triangle t = triangle(uv, f);
      const double area = orient(t[0], t[1], t[2]);
      if (area == 0) continue;
      const double sign = area > 0 ? 1 : -1;
      const auto rows = span(std::min({t[0].y, t[1].y, t[2].y}), std::max({t[0].y, t[1].y, t[2].y}), begin, end);
      for (int y = rows.first; y < rows.second; ++y) {
        // where the row's centre line crosses the triangle
        const double line = y + 0.5;
        double from = std::numeric_limits<double>::infinity(), to = -from;
        for (int k = 0; k < 3; ++k) {
          Point p = t[k], q = t[(k + 1) % 3];
          if (p.y > q.y) std::swap(p, q);
          if (line < p.y || line > q.y) continue;
          if (p.y == q.y) {
            from = std::min({from, p.x, q.x});
            to = std::max({to, p.x, q.x});
            continue;
          }
          const double x = p.x + (q.x - p.x) * ((line - p.y) / (q.y - p.y));
          from = std::min(from, x);
          to = std::max(to, x);
        }
        if (from > to) continue;
        const auto columns = span(from, to, left, left + width);
        for (int x = columns.first; x < columns.second; ++x) {
          const size_t i = at(x, y);
          if (out.inside[i]) continue;
          const Point p{x + 0.5, line};
          const double a = std::max(sign * orient(p, t[1], t[2]), 0.0), b = std::max(sign * orient(p, t[2], t[0]), 0.0);
          const double c = std::max(sign * orient(p, t[0], t[1]), 0.0), sum = a + b + c;
          if (sum <= 0) continue;
          out.inside[i] = 1;
          put(i, f, a / sum, b / sum, c / sum);
        }
      }
    }
    std::vector<float> nearest(static_cast<size_t>(end - begin) * width, std::numeric_limits<float>::infinity());
    for (int e : edges_of[band]) {
      const int face = edges[2 * e], side = edges[2 * e + 1];
      const Triangle t = triangle(uv, face);
      const Point p = t[side], q = t[(side + 1) % 3], d = q - p;
      const double length = dot(d, d);
      const auto rows = span(std::min(p.y, q.y) - reach, std::max(p.y, q.y) + reach, begin, end);
      for (int y = rows.first; y < rows.second; ++y) {
        // only the part of a slanted edge that is within reach of the row
        double low = std::min(p.x, q.x), high = std::max(p.x, q.x);
        if (d.y != 0) {
          const double s = std::clamp((y + 0.5 - reach - p.y) / d.y, 0.0, 1.0);
          const double u = std::clamp((y + 0.5 + reach - p.y) / d.y, 0.0, 1.0);
          low = p.x + std::min(s * d.x, u * d.x);
          high = p.x + std::max(s * d.x, u * d.x);
        }
        const auto columns = span(low - reach, high + reach, left, left + width);
        for (int x = columns.first; x < columns.second; ++x) {
          const size_t i = at(x, y);
          if (out.inside[i]) continue;
          const Point c{x + 0.5, y + 0.5};
          const double s = length > 0 ? std::clamp(dot(c - p, d) / length, 0.0, 1.0) : 0;
          const float away = static_cast<float>(std::hypot(p.x + d.x * s - c.x, p.y + d.y * s - c.y));
          float& least = nearest[i - at(left, begin)];
          if (away > reach || away >= least) continue;
          least = away;
          double weights[3] = {0, 0, 0};
          weights[side] = 1 - s;
          weights[(side + 1) % 3] = s;
          put(i, face, weights[0], weights[1], weights[2]);
        }
      }
    }
  });
  return out;
}

}  // namespace lodpipe
