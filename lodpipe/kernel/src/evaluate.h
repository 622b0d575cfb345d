// What is the cheapest collapse of a vertex?
#pragma once
#include <algorithm>
#include <limits>

#include "around.h"
#include "merge.h"
#include "mesh_state.h"

namespace lodpipe {

constexpr int kVanishFaces = 4;  // a component of so few faces goes as a whole

struct Edge {
  int32_t v, u;  // v owns it
};

// Working memory of one thread.
struct Scratch {
  Buffer<Edge> edges;
  Buffer<int32_t> owned, component;
  Buffer<float> costs;
  Around around;
  Merge merge;
};

// Threads write to the candidates of their own vertices alone, and read nothing that others write.
class Evaluation {
 public:
  Evaluation(State& s, const Options& options, bool locks) : s_(s), options_(options), locks_(locks) {}

  // The cheapest collapse among the edges that v owns (those to vertices of a higher number). False, and nothing done,
  // if a neighbour is outside the vertices [begin, end).
  bool one(int32_t v, int32_t begin, int32_t end, Scratch& w) {
    Candidate& own = s_.candidates[v];
    const bool regular = !(s_.flags[v] & kIrregular);  // each neighbour follows v in just one face
    int32_t* owned = w.owned.refill(2 * static_cast<size_t>(s_.vertices[v].count));
    int faces = 0;
    bool inside = true;
    Around::each(s_, v, [&](const Spoke& spoke) {
      ++faces;
      inside &= (spoke.next >= begin && spoke.next < end) || spoke.next == kNone;
      if (spoke.next > v) *owned++ = spoke.next;
      if (regular) return;
      inside &= (spoke.previous >= begin && spoke.previous < end) || spoke.previous == kNone;
      if (spoke.previous > v) *owned++ = spoke.previous;
    });
    w.owned.end_at(owned);
    if (!inside) return false;
    const int32_t skip = own.todo & kDirty ? 0 : own.skip;
    own = {kInfinity, kNone, skip, static_cast<uint8_t>(skip ? kPassedOver : 0)};
    if (!regular) {
      std::sort(w.owned.begin(), w.owned.end());
      w.owned.resize(std::unique(w.owned.begin(), w.owned.end()) - w.owned.begin());
    }
    if (!faces) s_.flags[v] |= kDead;  // which nobody else reads: it has no neighbours
    if (w.owned.empty()) return true;
    if (faces < kVanishFaces && gather_component(v, w.component)) {
      own.todo |= kVanish;
      if (skip == 0) own.cost = vanishing_cost(w.component), own.partner = w.owned[0];
      return true;
    }
    if (skip >= static_cast<int32_t>(w.owned.size())) return true;
    w.costs.resize(w.owned.size());
    w.merge.costs(s_, options_, v, w.owned, w.costs.data());
    for (int n = 0;; ++n) {
      const auto best = std::min_element(w.costs.begin(), w.costs.end());
      if (n == skip) {
        if (*best < kInfinity) own.cost = *best, own.partner = w.owned[best - w.costs.begin()];
        return true;
      }
      *best = kInfinity;
    }
  }

  // Evaluates what has to be of the live vertices [begin, end): where nothing but planes counts, by their edges, four of
  // them at a time.
  void many(int begin, int end, Scratch& w) {
    const bool planes = options_.placement == Placement::optimal && !s_.steering && !locks_;
    w.edges.clear();
    for (int i = begin; i < end; ++i) {
      const int32_t v = s_.live[i];
      Candidate& own = s_.candidates[v];
      if (!(own.todo & (kDirty | kRetry))) continue;
      const size_t first = w.edges.size();
      int faces = 0;
      if (planes && !(s_.flags[v] & kIrregular) && own.todo & kDirty) {
        Edge* edge = w.edges.grow(static_cast<size_t>(s_.vertices[v].count));
        Around::each(s_, v, [&](const Spoke& spoke) {
          *edge = {v, spoke.next};  // without a branch, which would be guessed wrong half of the time
          edge += spoke.next > v;
          ++faces;
        });
        w.edges.end_at(edge);
      }
      if (faces < kVanishFaces) {
        w.edges.resize(first);
        one(v, 0, std::numeric_limits<int32_t>::max(), w);
      } else {
        own = {kInfinity, kNone, 0, 0};
      }
    }
    for (size_t i = 0; i < w.edges.size(); i += 4) {
      const Vertex *a[4], *b[4];
      for (size_t k = 0; k < 4; ++k) {
        const Edge& edge = w.edges[std::min(i + k, w.edges.size() - 1)];
        a[k] = &s_.vertices[edge.v], b[k] = &s_.vertices[edge.u];
      }
      Lanes cost;
      FourPoints place;
      const int sound = Merge::four_places(FourVertices::of(a), FourVertices::of(b), &cost, &place);
      for (size_t k = 0; k < 4 && i + k < w.edges.size(); ++k) {
        const Edge& edge = w.edges[i + k];
        Candidate& own = s_.candidates[edge.v];
        const float c = sound >> k & 1 ? cost[k] : w.merge.cost(s_, options_, edge.v, edge.u);
        if (c < own.cost) own.cost = c, own.partner = edge.u;
      }
    }
  }

  // The vertices of v's component if it has at most kVanishFaces faces.
  bool gather_component(int32_t v, Buffer<int32_t>& members) const {
    members.clear();
    members.push_back(v);
    int faces = 0;
    for (size_t i = 0; i < members.size(); ++i) {
      int here = 0;
      bool links = false;
      Around::each(s_, members[i], [&](const Spoke& spoke) {
        links |= spoke.link();
        if (++here > kVanishFaces || links) return;
        faces += slot_of(spoke.corner) == 0;
        for (const int32_t u : {spoke.next, spoke.previous})
          if (std::find(members.begin(), members.end(), u) == members.end()) members.push_back(u);
      });
      if (links || here > kVanishFaces || members.size() > 4 || (s_.flags[members[i]] & kLocked)) return false;
    }
    return faces <= kVanishFaces;
  }

 private:
  float vanishing_cost(const Buffer<int32_t>& members) const {
    const Vec3 origin = s_.vertices[members[0]].p;
    Quadric sum;
    Vec3 middle;
    for (const int32_t m : members) {
      Quadric q = s_.vertices[m].q;
      q.move_origin(origin - s_.vertices[m].p);
      sum += q;
      middle = middle + (s_.vertices[m].p - origin) * (1.0f / static_cast<float>(members.size()));
    }
    Vec3 y = middle;
    if (!sum.minimise(kDamping * sum.trace(), middle, &y)) y = middle;
    return std::max(sum.at(y), 0.0f);
  }

  State& s_;
  const Options& options_;
  const bool locks_;  // some vertices are locked
};

}  // namespace lodpipe
