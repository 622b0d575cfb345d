// The mesh while it is being simplified, and what a collapse would make of it.
#pragma once
#include <cstdint>
#include <utility>
#include <vector>

#include "similarity.h"
#include "vector.h"

namespace lodpipe::similarity {

constexpr int32_t kNone = -1;

struct Face {
  int32_t v[3], w[3];
  int32_t source;  // row of the input
  bool dead = false;
  bool has(int32_t vertex) const { return v[0] == vertex || v[1] == vertex || v[2] == vertex; }
  int slot(int32_t vertex) const { return v[0] == vertex ? 0 : v[1] == vertex ? 1 : 2; }
};

// A plan: what the collapse gone → kept would do. Reused, so that planning allocates nothing.
struct Collapse {
  int32_t gone = kNone, kept = kNone;
  Point place;                          // of `kept` afterwards
  bool moves = false;                   // whether that is a new place
  bool whole = false;                   // the component of both goes, as a whole
  std::vector<int32_t> before;          // faces of the region T_k
  std::vector<int32_t> after;           // those of them that stay, T_{k+1}
  std::vector<int32_t> removed;
  struct Wedge {
    int32_t from, to;
    int row;  // of `fresh`: the values of `to` afterwards; −1: as they are
  };
  std::vector<Wedge> wedges;            // of gone and, when they change, of kept
  std::vector<double> fresh;            // × columns
  double deviation = 0;                 // root mean square distance to the planes that were merged

  const Wedge* find(int32_t wedge) const {
    for (const Wedge& w : wedges)
      if (w.from == wedge) return &w;
    return nullptr;
  }
};

class Mesh {
 public:
  Mesh(const Input& input);

  const Input& input;
  int columns;
  Point center;
  double scale = 1;  // input units → unit diagonal
  std::vector<Point> p;
  std::vector<Face> faces;
  std::vector<std::vector<int32_t>> ring;  // live faces round each vertex
  std::vector<float> value;                // of wedges, × columns
  std::vector<uint8_t> vertex_moved, wedge_moved;
  int64_t triangles = 0;
  double mean_area = 0;

  bool locked(int32_t v) const { return input.locked && input.locked[v]; }
  const float* values(int32_t wedge) const { return value.data() + static_cast<size_t>(wedge) * columns; }
  Point area_vector(const Face& f) const { return cross(p[f.v[1]] - p[f.v[0]], p[f.v[2]] - p[f.v[0]]) * 0.5; }

  // Distinct neighbours of v with the number of faces that each shares with it.
  void neighbours(int32_t v, std::vector<std::pair<int32_t, int>>& out) const;
  // The faces of v's component if there are at most `most`.
  bool component(int32_t v, int most, std::vector<int32_t>& out) const;

  void apply(const Collapse& c);
  void vanish(const Collapse& c);

  void emit(int64_t target, Stop stop, bool relaxed, double error, std::vector<Level>& out) const;
  void note(const Collapse& c, int32_t gone, int removed, double error, Record& out) const;

 private:
  void unlink(int32_t face);
  Point world(int32_t v) const;
  void values_of(int32_t wedge, float* out) const;
};

}  // namespace lodpipe::similarity
