// Where a patch is looked at from, and at which points.
#pragma once
#include <vector>

#include "../quadric.h"
#include "vector.h"

namespace lodpipe::similarity {

constexpr double kInset = 0.98;  // samples are drawn towards the triangle's middle: no ray runs along an edge

// `count` unit vectors spread evenly over the hemisphere z > 0 (a Fibonacci lattice), from the top down: row i has
// z = 1 − (i + ½) / count.
std::vector<Point> hemisphere(int count);

// A frame whose third axis is the unit vector given (Duff et al. 2017, "Building an orthonormal basis, revisited").
struct Frame {
  explicit Frame(Point axis);
  Point turned(Point p) const { return u * p.x + v * p.y + w * p.z; }
  Point u, v, w;
};

// Adds the points of scan lines over the triangle (a, b, c): parallel to ab, `step` apart, the first one on ab itself;
// on each line every `step` from its left end (Liao 2004, section 3.2.2).
void scan_lines(Point a, Point b, Point c, double step, std::vector<Vec3>& out);

}  // namespace lodpipe::similarity
