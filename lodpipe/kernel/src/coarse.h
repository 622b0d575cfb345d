// Many collapses at once, for the way down to a level that is still far: pairs of vertices, none of which is in two.
//
// Pairs are matched, placed, checked together against the faces that they would leave, and written; then the lists of
// corners are made anew. Each step is a pass over plain arrays, every item by itself: the result is the same for any
// number of threads. Only vertices inside of a surface and of a chart take part; the rest is left to other rounds.
#pragma once
#include <atomic>
#include <vector>

#include "around.h"
#include "merge.h"
#include "mesh_state.h"
#include "parallel.h"
#include "prepare.h"

namespace lodpipe {

class CoarseRound {
 public:
  CoarseRound(State& s, const Options& options, Pool& pool) : s_(s), options_(options), pool_(pool) {}

  // Whether nothing is asked for that such rounds know nothing of: topology, attributes that steer, a record.
  static bool suits(const State& s, const Options& options) {
    return options.placement == Placement::optimal && !s.steering && !s.has_links && !options.keep_topology &&
           !options.record && options.max_error < 0;
  }

  // Makes what can be made together of the candidates of `order`, vertices whose candidates are exact. How many.
  int64_t run(const std::vector<int32_t>& order) {
    match(order);
    place();
    check_all_faces();
    while (!refused_.empty()) {
      take_back();
      check_round_back();
    }
    const int64_t done = write();
    rename_faces();
    list_corners(s_);
    return done;
  }

 private:
  static constexpr int kGrain = 4096;

  struct Pair {
    int32_t v, u;  // u goes
  };
  struct Move {
    Vec3 to;
    int32_t into;  // the pair's v, for both of its ends; kNone: stays as it is
  };

  bool plain(int32_t v) const { return !(s_.flags[v] & (kDead | kLocked | kSeveralWedges | kIrregular)); }

  void match(const std::vector<int32_t>& order) {
    moves_.resize(s_.vertices.size());
    pool_.range(static_cast<int>(s_.live.size()), kGrain, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) moves_[s_.live[i]] = {s_.vertices[s_.live[i]].p, kNone};
    });
    pairs_.clear();
    for (const int32_t v : order) {
      const Candidate& c = s_.candidates[v];
      const int32_t u = c.partner;
      if (c.todo & kVanish || moves_[v].into != kNone || moves_[u].into != kNone || !plain(v) || !plain(u)) continue;
      moves_[v].into = moves_[u].into = v;
      pairs_.push_back({v, u});
    }
  }

  void place() {
    pool_.range(static_cast<int>(pairs_.size()), kGrain, [&](int begin, int end) {
      Merge merge;
      for (int i = begin; i < end; i += 4) {
        const Vertex *a[4], *b[4];
        for (int k = 0; k < 4; ++k) {
          const Pair& pair = pairs_[std::min(i + k, end - 1)];
          a[k] = &s_.vertices[pair.v], b[k] = &s_.vertices[pair.u];
        }
        Lanes cost;
        FourPoints place;
        const int sound = Merge::four_places(FourVertices::of(a), FourVertices::of(b), &cost, &place);
        for (int k = 0; k < 4 && i + k < end; ++k) {
          const Pair& pair = pairs_[i + k];
          Vec3 y{place.x[k], place.y[k], place.z[k]};
          if (!(sound >> k & 1)) merge.place(s_, options_, pair.v, pair.u, &y);
          moves_[pair.v].to = moves_[pair.u].to = a[k]->p + y;
        }
      }
    });
  }

  // Whether a face changes and stays a face.
  bool changes(const Face& f) const {
    const int32_t a = moves_[f.v[0]].into, b = moves_[f.v[1]].into, c = moves_[f.v[2]].into;
    return ((a & b & c) >= 0) & !(((a == b) | (a == c)) & (a >= 0)) & !((b == c) & (b >= 0));
  }

  // Collects the pairs at faces that would turn over or become slivers.
  void check_all_faces() {
    const auto count = static_cast<int>(s_.faces.size());
    bad_.resize(static_cast<size_t>(count) / kGrain + 1);
    pool_.range(count, kGrain, [&](int begin, int end) {
      std::vector<int32_t>& bad = bad_[begin / kGrain];
      bad.clear();
      int32_t faces[kGrain];
      int changed = 0;
      for (int i = begin; i < end; ++i) {
        faces[changed] = i;  // without a branch, which would be guessed wrong too often
        changed += !s_.faces[i].dead() && changes(s_.faces[i]);
      }
      for (int i = 0; i < changed; i += 4) check_four(faces + i, std::min(changed - i, 4), &bad);
    });
    refused_.clear();
    for (const std::vector<int32_t>& bad : bad_) refused_.insert(refused_.end(), bad.begin(), bad.end());
  }

  // The same for the faces round what was taken back.
  void check_round_back() {
    refused_.clear();
    for (const int32_t v : back_)
      Around::each(s_, v, [&](const Spoke& spoke) {
        const int32_t face = face_of(spoke.corner);
        if (changes(s_.faces[face])) check_four(&face, 1, &refused_);
      });
  }

  void check_four(const int32_t* faces, int count, std::vector<int32_t>* bad) const {
    FourPoints before[3], after[3];
    for (int i = 0; i < 3; ++i) {
      const void *p[4], *x[4];
      for (int k = 0; k < 4; ++k) {
        const int32_t v = s_.faces[faces[std::min(k, count - 1)]].v[i];
        p[k] = &s_.vertices[v], x[k] = &moves_[v];
      }
      before[i] = FourPoints::of_rows(p), after[i] = FourPoints::of_rows(x);
    }
    const int found = four_bad(before, after, options_.flip_cos);
    if (!found) return;
    for (int k = 0; k < count; ++k)
      for (const int32_t v : s_.faces[faces[k]].v)
        if (found >> k & 1 && moves_[v].into != kNone) bad->push_back(moves_[v].into);
  }

  // Undoes the pairs that were refused.
  void take_back() {
    back_.clear();
    for (const int32_t v : refused_) {
      if (moves_[v].into == kNone) continue;  // it is there twice
      const int32_t u = s_.candidates[v].partner;
      for (const int32_t end : {v, u}) {
        moves_[end] = {s_.vertices[end].p, kNone};
        back_.push_back(end);
      }
      ++s_.candidates[v].skip;
      s_.candidates[v].todo |= kRetry | kPassedOver;
    }
  }

  int64_t write() {
    std::atomic<int64_t> done = 0;
    pool_.range(static_cast<int>(s_.live.size()), kGrain, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) {  // merging only makes edges dearer: other candidates stay
        Candidate& c = s_.candidates[s_.live[i]];
        if (c.partner != kNone && moves_[c.partner].into != kNone) c.todo |= kDirty;
      }
    });
    pool_.range(static_cast<int>(pairs_.size()), kGrain, [&](int begin, int end) {
      int64_t count = 0;
      for (int i = begin; i < end; ++i)
        if (moves_[pairs_[i].v].into != kNone) merge(pairs_[i]), ++count;
      done += count;
    });
    return done;
  }

  void merge(const Pair& pair) {
    Vertex &a = s_.vertices[pair.v], &b = s_.vertices[pair.u];
    Quadric q = b.q;
    q.move_origin(a.p - b.p);
    q += a.q;
    const Vec3 x = moves_[pair.v].to;
    q.move_origin(x - a.p);
    const float trace = q.trace();
    const float deviation = trace > 0 ? std::sqrt(std::max(q.c, 0.0f) / trace) : 0;
    a.error = std::max({a.error, b.error, deviation});
    a.q = q, a.p = x;
    s_.flags[pair.v] |= kMoved;
    s_.flags[pair.u] = kDead;
    s_.candidates[pair.v].todo |= kDirty;
    s_.candidates[pair.u].cost = kInfinity;
    b.count = 0;
    if (!s_.vertex_into.empty()) s_.vertex_into[pair.u] = pair.v;
    if (!s_.wedge_into.empty()) s_.wedge_into[WedgeGroups::first_wedge(s_, pair.u)] = WedgeGroups::first_wedge(s_, pair.v);
  }

  // Gives the faces their new vertices and wedges, and leaves out those that are gone.
  void rename_faces() {
    // plain pointers: the arrays' own would be read again after each store
    Face* const faces = s_.faces.data();
    Wedges* const wedges = s_.wedges.data();
    const Move* const moves = moves_.data();
    const int32_t* const wedge_into = s_.wedge_into.empty() ? nullptr : s_.wedge_into.data();
    size_t kept = 0;
    for (size_t i = 0; i < s_.faces.size(); ++i) {
      Face f = faces[i];
      if (f.dead()) continue;
      Wedges w = wedges[i];
      for (int k = 0; k < 3; ++k) {
        const int32_t into = moves[f.v[k]].into;
        f.v[k] = into != kNone ? into : f.v[k];
        if (wedge_into) w.w[k] = wedge_into[w.w[k]];  // itself, but for what has just been merged
      }
      faces[kept] = f, wedges[kept] = w;
      kept += (f.v[0] != f.v[1]) & (f.v[1] != f.v[2]) & (f.v[0] != f.v[2]);
    }
    s_.faces.resize(kept), s_.wedges.resize(kept);
    s_.triangles = static_cast<int64_t>(kept);
  }

  State& s_;
  const Options& options_;
  Pool& pool_;
  std::vector<Pair> pairs_;
  Large<Move> moves_;                      // of the vertices
  std::vector<std::vector<int32_t>> bad_;  // pairs, of each piece of the faces
  std::vector<int32_t> refused_, back_;    // pairs, and the ends of those that were taken back
};

}  // namespace lodpipe
