// UV layouts: charts, overlaps, gutters, and which triangle lies under each texel.
#pragma once
#include <cstdint>
#include <vector>

namespace lodpipe {

// Labels of faces that hang together by edges: 0, 1, … in the order of their first faces. `faces` holds 3·count
// corners; faces that share two corners share an edge.
std::vector<int32_t> chart_labels(const int32_t* faces, int count);

// (nodes,) the lowest node of each node's connected part; `pairs` holds 2·count nodes.
std::vector<int32_t> join_pairs(const int32_t* pairs, int count, int nodes);

// Triangles in the plane: 6 doubles each, of a chart and a group; only those of one group are compared.
struct UvFaces {
  const double* uv;
  const int32_t* chart;
  const int32_t* group;
  int count;
};

struct UvOverlaps {
  std::vector<int32_t> charts;  // pairs, the lower first; a chart may overlap itself
  std::vector<double> area;     // for each pair: shared by triangles of one orientation, by opposite ones
  std::vector<uint8_t> faces;   // whether a face overlaps another
  bool complete = true;         // false: more than `limit` pairs of triangles touch; the rest was not looked at
};
// Common areas of triangles, by clipping. What is thinner than `slack` counts as touching.
UvOverlaps uv_overlaps(const UvFaces& in, double slack, int64_t limit);

// Area of each group that at least one triangle covers, and at least two: exact along scan lines, at most `lines`
// for each group, fewer where that would take more than 2e7 crossings.
std::vector<double> uv_coverage(const UvFaces& in, int groups, int lines);

// The smallest distance, up to `reach`, between segments of different charts in each group; 4 doubles a segment.
std::vector<double> uv_gaps(const double* segments, const int32_t* chart, const int32_t* group, int count, int groups,
                            double reach);

// The triangle under each texel's centre of the window (left, top, width, height), in texels; the lowest where there
// are several. Up to `reach` outside: the nearest point of `edges` (pairs of face and side; side k runs from corner k).
struct UvRaster {
  std::vector<int32_t> faces;  // width · height, −1: nothing near
  std::vector<float> weights;  // 3 barycentric coordinates for each texel
  std::vector<uint8_t> inside;
};
UvRaster uv_raster(const double* uv, int count, const int32_t* edges, int edge_count, int left, int top, int width,
                   int height, double reach, int threads);

// Puts charts side by side into a rectangle of texels, at the largest scale that fits. `uv` are triangles in any unit,
// the lowest corner of each chart's box at the origin; charts may be turned by quarters.
struct UvPacking {
  double scale = 0;             // texels to a unit; 0: the charts do not fit at all
  std::vector<double> corner;   // for each chart: where the lowest corner of its turned box goes, in texels
  std::vector<int32_t> turn;    // quarters, counter-clockwise for a v that points up
};
UvPacking uv_pack(const UvFaces& in, int charts, int width, int height, double padding, int cells, double largest);

}  // namespace lodpipe
