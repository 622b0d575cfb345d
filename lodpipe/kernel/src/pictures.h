// Operations on pictures: encoding, shrinking, structural similarity, and what can be seen from afar; and the look-ups
// that shading a picture takes.
#pragma once
#include <cstdint>

#include "wrap.h"

namespace lodpipe {

// What a premultiplied picture stands on, linear or as `linear` says: see `finish`.
struct Ground {
  float colour[3];
  bool linear;
};

// `count` sRGB values of linear light, both 0…1.
void to_srgb(const float* linear, int64_t count, float* out);

// (count, 3) sRGB values of premultiplied RGBA (count, 4) on a ground; if that is linear the values are encoded.
void finish(const float* rgba, int64_t count, const Ground& ground, float* out);

// A picture (from, from, 4) in `size` rows: the mean of the pixels whose centres lie in the new pixel's area, and of the
// one that holds its centre where there is none.
void shrink(const float* rgba, int from, int size, float* out);

// Structural similarity (Wang, Bovik, Sheikh & Simoncelli 2004): means over the pixels `shown`, of the whole and of its
// contrast-and-structure part. The borders are mirrored; both sides are at least `radius` long.
struct Similarity {
  double whole, structure;
};
Similarity similarity(const float* a, const float* b, const uint8_t* shown, int height, int width, const float* taps,
                      int radius);

// Of two premultiplied pictures (size, size, 4), `height` pixels high: how many pixels are covered, and how many of them
// lie in a 2 × 2 square of pixels of which neither picture's can be made from the other's by moves of up to a pixel and
// changes up to `noticed`. docs/measuring.md, "Seen from afar".
struct Differing {
  int64_t shown, differ;
};
Differing differing(const float* a, const float* b, int size, int height, const Ground& ground, float noticed);

// (count, columns) values at places on faces: the mean of the rows `corners` (F, 3) of `values` (·, columns), or if that
// is null of the rows 3f … 3f + 2, weighted by `weights` (count, 3). False: a row is not among the `rows` that there are.
bool blend(const float* values, int64_t rows, int columns, const int32_t* corners, const int32_t* faces,
           const float* weights, int64_t count, float* out);

// A texture with its mip levels, one after the other: RGBA bytes, and what they mean as linear values.
struct MipTexels {
  const uint8_t* texels;
  const int64_t* start;  // of each level, in texels
  const int32_t *width, *height;
  int levels;
  const float* meaning;  // (256,) of colours; alpha is plain
  Wrap wrap_u, wrap_v;
  bool nearest;
};
// (count, 4) at `uv` (count, 2), v = 0 at the top; `footprint` (count,) is a pixel's size in texels, null: 1.
void sample(const MipTexels& texture, const float* uv, const float* footprint, int64_t count, float* out);

}  // namespace lodpipe
