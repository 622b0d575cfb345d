// Silhouettes of small meshes as bits, and how far they overlap with wanted ones: thousands of variants in a second.
#pragma once
#include <cstdint>
#include <vector>

namespace lodpipe {

struct SilhouetteViews {
  const double* axes;  // count × 6: vectors to the right and up; a point's pixel is ((p · axis + 1) / 2 · size)
  int count;
  int size;  // pixels along a side
  int words() const { return (size + 63) / 64; }
};

// count × size rows × words() words of 64 pixels: a pixel is set if its centre lies in a triangle's shadow.
std::vector<uint64_t> silhouettes(const double* points, const int32_t* faces, int face_count, const SilhouetteViews& views);

// The mean over the views of intersection over union with `wanted`.
double silhouette_overlap(const double* points, const int32_t* faces, int face_count, const SilhouetteViews& views,
                          const uint64_t* wanted);

// The same for meshes in each of which one vertex is elsewhere: `vertex` and `places` (× 3) of `moves` variants.
std::vector<double> silhouette_moves(const double* points, int vertex_count, const int32_t* faces, int face_count,
                                     const int32_t* vertex, const double* places, int moves,
                                     const SilhouetteViews& views, const uint64_t* wanted, int threads);

}  // namespace lodpipe
