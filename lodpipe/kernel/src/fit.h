// Fits a level to the surface that it stands for: least squares over samples of the original.
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

namespace lodpipe {

struct FitOptions {
  int samples = 0;            // spread over the original by area, about
  int moves = 2;              // rounds in which positions move; 0: values alone
  bool fit_values = true;
  int chart_column = -1;      // of `values`: u; v follows it. −1: none
  float flip_cos = 0.2f;      // least cosine between a face's normal before and after a move
  int threads = 1;
};

struct FitMesh {
  const double* positions;  // vertex_count × 3
  int vertex_count;
  const int32_t* faces;   // face_count × 3
  const int32_t* wedges;  // face_count × 3
  int face_count;
  const float* values;  // wedge_count × columns
  int wedge_count;
};

struct FitInput {
  FitMesh original, level;
  int columns;
  const float* importance;   // original.vertex_count or null: multiplies the area round the vertex
  const float* held;         // original.vertex_count or null: how strongly the seams at it hold their place, a length
  const int32_t* wedge_to;   // original.wedge_count: the level's wedge that stands for it; −1: none
};

struct FitResult {
  std::vector<double> positions;  // × 3
  std::vector<float> values;      // × columns
  std::vector<uint8_t> moved;     // level.vertex_count
};

FitResult fit(const FitInput& input, const FitOptions& options, const std::function<bool()>& go_on);

}  // namespace lodpipe
