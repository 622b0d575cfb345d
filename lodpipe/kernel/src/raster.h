// The triangles that the rays through a picture's pixels meet first, by drawing them: what casting the rays would find.
#pragma once
#include <cstdint>
#include <vector>

namespace lodpipe {

struct RasterView {
  double eye[3], right[3], up[3], ahead[3];  // a point of the picture plane or the eye, and unit vectors
  double size;                               // half the picture's height: a length, or with `perspective` a tangent
  bool perspective;
  int width, height;  // of the picture, of which the rows [top, bottom) are drawn
  int top, bottom;
};

struct Raster {
  bool complete;                // false: a vertex lies beside or behind the eye of a perspective view, and nothing is drawn
  std::vector<float> distance;  // along the ray, infinity where there is nothing
  std::vector<int32_t> face;    // −1 where there is nothing
  std::vector<float> uv;        // two a pixel: the point is (1 − u − v)·a + u·b + v·c
};

// Per pixel, rows from the top: the face that the ray through its centre meets first beyond `behind` (a distance for each
// pixel; null: in front of the eye). Of faces met at the same distance the one with the lowest number counts; an edge
// belongs to both of its faces, so that nothing shines through between them.
Raster raster(const float* positions, int vertices, const int32_t* faces, int count, const RasterView& view,
              const float* behind);

}  // namespace lodpipe
