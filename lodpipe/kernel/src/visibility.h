// Which parts of a surface are seen from outside: pictures of its faces, by parallel projection.
#pragma once
#include <cstdint>
#include <vector>

namespace lodpipe {

struct VisibilityInput {
  const float* positions;  // vertex_count × 3, within the unit sphere
  int vertex_count;
  const int32_t* faces;  // face_count × 3
  int face_count;
  const uint8_t* hides;  // face_count: 0 for what covers nothing and counts as seen
  const double* views;   // view_count × 3 unit vectors; each stands for its opposite, too
  int view_count;
  int side;  // pixels of a picture of the sphere, each way
  int threads;
};

// For each vertex 0…1: of the pixels that its faces would take up if they were alone, the share that they do, one
// side of them taken alone; where those are few, the share of the views in which it lies in front. The largest among the
// vertex and its neighbours.
std::vector<float> vertex_visibility(const VisibilityInput& in);

}  // namespace lodpipe
