// Normals made from the triangles, smooth but for creases.
#pragma once
#include <cstdint>

namespace lodpipe {

// `normals` gets nine floats a face, a unit normal for each corner: the mean of the faces around its vertex whose normals
// have a cosine of `least` or more with its own face's, each weighted by its angle at the vertex (Thürmer & Wüthrich 1998);
// zero where none of them has an area. Of more than 1,024 faces around a creased vertex, a corner looks at the 1,024 that
// are next to it in the list.
void crease_normals(const double* positions, int vertices, const int32_t* faces, int count, double least, int threads,
                    float* normals);

// `normals` gets three floats a face: its unit normal, zero without an area.
void face_normals(const float* positions, const int32_t* faces, int count, float* normals);

}  // namespace lodpipe
