// Plans collapses and refuses those that the guards forbid.
#pragma once
#include <array>

#include "mesh.h"
#include "placement.h"

namespace lodpipe::similarity {

enum class Topology { free = 0, edges = 1, links = 2 };  // what is guarded: nothing, faces of an edge, the link too

class Planner {
 public:
  Planner(const Mesh& mesh, const Options& options, const Scene& scene);

  // Working memory of one thread.
  struct Scratch {
    std::vector<std::pair<int32_t, int>> near_gone, near_kept;
    std::vector<int32_t> members, opposite;
    std::vector<int> group, slot;
    int of_kept = 0;  // so many of the members are wedges of the vertex that stays
    std::vector<std::vector<int32_t>> groups;
    std::vector<std::array<double, 2>> uv;
  };

  // Fills `c` with the collapse gone → kept (full: of the edge). Stop::triangles if nothing forbids it. `exists` is
  // false if no face has both vertices any more.
  Stop plan(int32_t gone, int32_t kept, Collapse& c, Scratch& w, bool* exists) const;
  void merged(const Collapse& c) { placement_.merge(c); }

 private:
  bool keeps_topology(const Collapse& c, Scratch& w) const;
  bool strands_locked(const Collapse& c) const;
  bool group_wedges(const Collapse& c, Scratch& w) const;
  bool carry_half(Collapse& c, Scratch& w) const;
  void carry_full(Collapse& c, Scratch& w) const;
  int extend(Collapse& c, int32_t wedge) const;
  bool turns(const Collapse& c) const;

  const Mesh& mesh_;
  const Options& options_;
  const Scene& scene_;
  Placement placement_;
  std::vector<int> uv_columns_;  // the first of each pair

 public:
  Topology topology;
};

}  // namespace lodpipe::similarity
