// Closest points of a surface: its triangles in a tree of boxes with four children a node.
//
// The order of the leaves is the Morton order of the triangles' middles (Lauterbach et al. 2009), which makes building it
// little more than a sort. Boxes are single precision, as the vertices are; what a triangle is asked is worked out in
// double precision, so that long slivers are as exact as others. Answers do not depend on the order of the visit: of
// triangles that are equally near the one with the lowest number counts.
#pragma once
#include <cstdint>
#include <vector>

#include "memory.h"
#include "similarity/vector.h"

namespace lodpipe {

class TriangleTree {
 public:
  using Point = similarity::Point;

  // `positions` rows of three, finite; `faces` rows of three of them. Faces without area count as their edges.
  TriangleTree(const float* positions, const int32_t* faces, int count);

  struct Found {
    double square;  // of the distance
    int32_t face;   // −1 in a tree without triangles
    Point point;
  };
  // The closest point to each of `count` points (rows of three): distance, point (rows of three) and face.
  void closest(const float* points, int count, int threads, double* distance, double* found, int32_t* face) const;

  // For each point the face whose normal has a positive product with `normal` (rows of three, unit length) and that meets
  // the line through the point along it nearest to the point, within ±reach; −1 where there is none.
  void facing(const float* points, const double* normals, const double* reach, int count, int threads,
              int32_t* face) const;

 private:
  static constexpr int kWide = 4, kLeaf = 3, kDepth = 288;  // kDepth: 3 × (63 bits + 32 halvings) and one
  struct Box {
    float low[3], high[3];
  };
  struct Node {
    float low[3][kWide], high[3][kWide];
    int32_t child[kWide];  // a node; or ~first of a leaf's triangles
    int32_t size[kWide];   // of a leaf, 0: a node
  };
  struct Keyed {
    uint64_t key;
    int32_t id;
  };

  Box build(const std::vector<Keyed>& order, int begin, int end, int32_t at);
  int split(const std::vector<Keyed>& order, int begin, int end) const;
  Box bounds(int begin, int end) const;
  Found nearest(Point p, const float* single, int32_t hint) const;
  int32_t facing(Point p, Point normal, double reach) const;
  void try_triangle(int32_t row, Point p, Found& best) const;

  Large<float> corners_;  // nine for each triangle, in the order of the leaves
  Large<int32_t> face_;   // and its face
  Large<int32_t> row_;    // of each face, its place among the leaves
  Large<Node> nodes_;
};

}  // namespace lodpipe
