// Quadric error decimation of an indexed triangle mesh whose positions may have several wedges.
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

namespace lodpipe {

enum class Placement { optimal = 0, endpoint = 1, midpoint = 2 };
enum class Weighting { uniform = 0, area = 1, area_angle = 2 };
enum class Stop { triangles = 0, error = 1, topology = 2, flip = 3, seams = 4, locked = 5, last = 6, cancelled = 7 };
constexpr int kStops = 8;

struct Options {
  Placement placement = Placement::optimal;
  Weighting weighting = Weighting::area;
  float boundary_weight = 0.15f, seam_weight = 0.03f, crease_weight = 0;
  float crease_cos = 0.5f;       // cosine of the dihedral turn from which an edge is a crease
  double pair_distance = 0;      // object units; 0: edges only
  bool attribute_cost = true;    // false: attributes are carried, but do not steer
  bool keep_topology = false;    // link condition; relaxed only when nothing else is left, if `may_relax`
  bool may_relax = true;
  float flip_cos = 0.2f;         // least cosine between a face's normal before and after
  float round_share = 1.0f / 16; // share of the live vertices that one round considers
  double max_error = -1;         // object units; negative: none
  bool keep_last = false;        // the last triangles stay, whatever the target
  int chart_column = -1;         // of `values`: u; v follows it. At seams they stay within their chart. −1: none
  int threads = 1;
  bool record = false;
  bool follow = false;           // levels say which of their vertices and wedges stand for the input's
};

struct Input {
  const double* positions;     // vertex_count × 3
  int vertex_count;
  const int32_t* faces;        // face_count × 3
  const int32_t* wedges;       // face_count × 3
  int face_count;
  const float* values;         // wedge_count × columns
  int wedge_count;
  int columns;
  const float* column_weights; // columns; object units for each unit of the value; 0: carried only
  const float* importance;     // vertex_count or null
  const uint8_t* locked;       // vertex_count or null
  const float* seam_scale;     // face_count × 3 or null: multiplies seam_weight at the edge from corner k to k + 1
  std::vector<int64_t> targets;  // triangles, descending
};

struct Level {
  int64_t target = 0;
  Stop stop = Stop::triangles;
  double error = 0;                    // estimate of the deviation, object units
  bool relaxed = false;                // the link condition had to be given up
  std::vector<double> positions;       // × 3
  std::vector<int32_t> vertex_source;  // row of the input; −1: a new position
  std::vector<int32_t> faces, wedges;  // × 3
  std::vector<int32_t> face_source;    // row of the input
  std::vector<float> values;           // × columns
  std::vector<int32_t> wedge_source;   // row of the input; −1: new values
  std::vector<int32_t> vertex_to, wedge_to;  // of the input, with `follow`: what stands for it; −1: nothing any more
};

// The sequence of collapses. A prefix of it, applied to the input, gives every level between.
struct Record {
  std::vector<int32_t> removed, kept;  // input vertices; removed → kept
  std::vector<double> positions;       // × 3, of `kept` afterwards
  std::vector<int32_t> triangles;      // faces that the collapse removed
  std::vector<float> error;            // estimate so far, object units
  std::vector<int32_t> wedge_event;    // row of the collapse
  std::vector<int32_t> wedge_from, wedge_to;  // equal: only the values change
  std::vector<float> wedge_values;     // × columns, of `wedge_to` afterwards
};

struct Result {
  std::vector<Level> levels;
  Record record;
};

// What each edge (or link) of the input would cost to begin with, for looking into and for comparison with other code.
struct EdgeCosts {
  std::vector<int32_t> edges;     // × 2, rows of the input
  std::vector<float> cost;        // of the mesh scaled to a bounding box of unit diagonal
  std::vector<double> positions;  // × 3, where the merged vertex would be
};
EdgeCosts edge_costs(const Input& input, const Options& options);

// `progress(removed, total)` returns false to stop; it is called from the calling thread only.
Result decimate(const Input& input, const Options& options, const std::function<bool(int64_t, int64_t)>& progress);

}  // namespace lodpipe
