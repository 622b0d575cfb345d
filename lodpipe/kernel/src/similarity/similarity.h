// Decimation by what is seen: the literal algorithm of Liao 2004 ("Mesh simplification with geometry and material
// preserving", NCTU), and two costs that it is compared with: texture deviation (Cohen, Olano & Manocha 1998) and
// image-driven (Lindstrom & Turk 2000). One queue of half-edges or edges, evaluated lazily.
//
// Written to be read and to be an oracle for faster forms; see ../decimate.h for the fast quadric loop.
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "../decimate.h"
#include "../wrap.h"

namespace lodpipe::similarity {

enum class Metric { ray = 0, texture_deviation = 1, image = 2 };
enum class Reference { original = 0, previous = 1 };
enum class Correspondence { uv = 0, scene = 1 };
enum class Penalty { constant = 0, view = 1 };

struct Options {
  Metric metric = Metric::ray;
  bool full = false;                // edges to a new vertex (GH98); else half-edges
  Reference reference = Reference::original;
  Correspondence correspondence = Correspondence::scene;
  int views = 8;                    // on the hemisphere
  double spacing = 1;               // of the scan lines, in √(2 · mean area of the input's triangles)
  Penalty penalty = Penalty::constant;
  int image_size = 256;             // of each of the 20 pictures
  double flip_cos = 0;              // least cosine between a face's normal before and after
  bool keep_topology = false;       // link condition
  bool may_relax = true;
  bool cross_seams = true;          // a vertex may leave a seam, its charts being extended
  bool keep_last = false;           // the last triangles stay, whatever the target
  int threads = 1;
  bool record = false;
};

struct Image {
  int width, height;
  const uint8_t* texels;        // height × width × 2: luminance, alpha
  Wrap wrap_u = Wrap::repeat, wrap_v = Wrap::repeat;
  bool nearest = false;
};

// What a material looks like: luminance and alpha of its colour, times its texture's.
struct Look {
  int image = -1;
  float luminance = 1, alpha = 1;
  int uv_column = -1;                    // of the values
  float matrix[6] = {1, 0, 0, 0, 1, 0};  // 2 × 3, from these values to the texture's coordinates
  float cutoff = -1;                     // alpha below it is not there; negative: alpha blends
};

struct Scene {
  const int32_t* face_look;  // face_count, rows of looks
  std::vector<Look> looks;
  std::vector<Image> images;
  int shade_column = -1;     // of the values: normal (3), luminance and alpha of the vertex colour; −1: none, white
  int uv_column = -1;        // of the values: u; v follows it. Correspondence, texture deviation, GH98. −1: none
};

struct Outcome {
  Result result;
  std::vector<double> costs;  // of the collapses in their order
  int64_t evaluations = 0;    // of costs, the first ones included
};

// Input and Record as for the quadric decimator; Input::column_weights weighs the UV columns in GH98's quadrics,
// importance multiplies costs. `progress(removed, total)` is called from the calling thread only; false stops.
Outcome simplify(const Input& input, const Scene& scene, const Options& options,
                 const std::function<bool(int64_t, int64_t)>& progress);

// What each candidate of the mesh as it is would cost, infinite where it is refused.
struct Costs {
  std::vector<int32_t> pairs;  // × 2: vertex that goes (full: lower end), vertex that stays
  std::vector<double> cost;
  std::vector<double> places;  // × 3, of the vertex that stays
};
Costs costs(const Input& input, const Scene& scene, const Options& options);

}  // namespace lodpipe::similarity
