// The loop: evaluate, pick, collapse, until the targets are met.
//
// A round evaluates what changed, picks the cheapest share of the candidates, and collapses those whose cost is still
// exact. Blocks of the Morton order, small enough for a core's cache, are collapsed side by side, and gone through again
// for what has become cheap enough meanwhile. A collapse whose ring leaves its block waits for blocks that lie otherwise,
// or for all others to end. Blocks depend on the mesh alone, so the result is the same for any number of threads.
// Where a round's share is large and the target is far, rounds are coarse instead.
#include "decimate.h"

#include <array>
#include <cmath>
#include <numeric>

#include "around.h"
#include "coarse.h"
#include "evaluate.h"
#include "merge.h"
#include "mesh_state.h"
#include "prepare.h"
#include "results.h"

namespace lodpipe {
namespace {

constexpr int kGrain = 512;        // vertices a piece of parallel work
constexpr int kBlock = 3072;       // vertices whose state fits into a core's cache
constexpr int kLeastBlock = 1024;  // live vertices
constexpr size_t kSample = 4096;   // costs that are looked at to find a share's limit
constexpr size_t kFew = 64;
constexpr float kCoarse = 0.3f;    // share from which rounds may be coarse
constexpr int64_t kNear = 16;      // they are while more than this part of the mesh has to go

class Decimator {
 public:
  Decimator(const Input& in, const Options& options, const std::function<bool(int64_t, int64_t)>& progress)
      : in_(in), options_(options), progress_(progress), pool_(std::max(options.threads, 1)), results_(in_, s_),
        evaluation_(s_, options_, in.locked), coarse_round_(s_, options_, pool_) {
    prepare(in_, options_, pool_, s_);
    keep_topology_ = options_.keep_topology;
    if (options_.follow) {
      s_.vertex_into.resize(s_.vertices.size());
      std::iota(s_.vertex_into.begin(), s_.vertex_into.end(), 0);
    }
    if (options_.follow || s_.late) {
      s_.wedge_into.resize(s_.wedge_source.size());
      std::iota(s_.wedge_into.begin(), s_.wedge_into.end(), 0);
    }
    coarse_ = options_.round_share >= kCoarse && CoarseRound::suits(s_, options_);
    max_error_ = options_.max_error < 0 ? kInfinity : static_cast<float>(options_.max_error * s_.scale);
  }

  Result run() {
    const int64_t start = s_.triangles;
    const int64_t last = in_.targets.empty() ? 0 : in_.targets.back();
    Stop stop = Stop::triangles;
    for (const int64_t target : in_.targets) {
      while (stop == Stop::triangles && s_.triangles > target) {
        if (!progress_(start - s_.triangles, start - last)) stop = Stop::cancelled;
        else if (!round(s_.triangles - target)) stop = stuck();
      }
      results_.emit(target, s_.triangles <= target ? Stop::triangles : stop, relaxed_, options_.follow, pool_);
    }
    return std::move(results_.result);
  }

 private:
  // ---------------------------------------------------------------- pick

  // Fills order_ with the cheapest share of the candidates, at most `most`. Many come in the order of their place, which
  // the caches like and costs nothing that could be measured; few in the order of cost, so that the last ones are exact.
  void pick(size_t most) {
    order_.clear();
    sample_.clear();
    const auto cost = [&](int32_t v) { return s_.candidates[v].cost; };
    const size_t step = std::max<size_t>(1, s_.live.size() / kSample);
    size_t looked = 0;
    for (size_t i = 0; i < s_.live.size(); i += step, ++looked)
      if (cost(s_.live[i]) < kInfinity) sample_.push_back(cost(s_.live[i]));
    float& limit = limit_ = std::numeric_limits<float>::max();
    const auto wanted = static_cast<size_t>(options_.round_share * static_cast<float>(looked));
    if (wanted + 1 < sample_.size()) {
      std::nth_element(sample_.begin(), sample_.begin() + static_cast<int64_t>(wanted), sample_.end());
      limit = sample_[wanted];
    }
    for (const int32_t v : s_.live)
      if (cost(v) <= limit) order_.push_back(v);
    const auto cheaper = [&](int32_t a, int32_t b) { return cost(a) != cost(b) ? cost(a) < cost(b) : a < b; };
    if (order_.size() > most) {
      const auto last = order_.begin() + static_cast<int64_t>(most) - 1;
      std::nth_element(order_.begin(), last, order_.end(), cheaper);
      const int32_t dearest = *last;
      limit = cost(dearest);
      order_.clear();
      for (const int32_t v : s_.live)
        if (cost(v) <= limit && !cheaper(dearest, v)) order_.push_back(v);
    }
    if (order_.size() < kFew) std::sort(order_.begin(), order_.end(), cheaper);
  }

  // ---------------------------------------------------------------- collapse

  enum class Outcome { done, touched, wait, refused };

  struct Block {
    int32_t begin = 0, end = 0;    // vertices
    bool whole = false;            // all of them: nothing needs to wait
    std::vector<int32_t> todo;     // rows of order_
    std::vector<int32_t> waiting;
    std::vector<int32_t> changed;  // vertices to evaluate again
    int64_t budget = 0;            // triangles that may go
    int64_t removed = 0, done = 0; // triangles, collapses
    std::array<int64_t, kStops> refused{};
    Notes notes;
    CornerLists::Room room;

    void start(int64_t from, int64_t to) {
      begin = static_cast<int32_t>(from), end = static_cast<int32_t>(to);
      todo.clear(), waiting.clear(), changed.clear(), notes.clear();
      budget = removed = done = 0, refused = {};
    }
    bool has(int32_t v) const { return v >= begin && v < end; }
  };

  // One round. False if nothing could be collapsed and nothing is left to be tried.
  bool round(int64_t wanted) {
    pool_.range(static_cast<int>(s_.live.size()), kGrain, [&](int begin, int end) {
      thread_local Scratch w;
      evaluation_.many(begin, end, w);
    });
    s_.live.erase(std::remove_if(s_.live.begin(), s_.live.end(), [&](int32_t v) { return s_.flags[v] & kDead; }),
                  s_.live.end());
    if (s_.corners.nearly_full()) compact_corners();
    // A collapse removes two triangles at most (others are left to the last part): so many cannot overshoot.
    pick(static_cast<size_t>(std::max<int64_t>(1, (wanted + 1) / 2)));
    if (order_.empty()) return false;
    if (coarse_ && wanted > s_.triangles / kNear) {
      const int64_t done = coarse_round_.run(order_);
      coarse_ = 8 * done > static_cast<int64_t>(order_.size());
      for (Block& b : blocks_) b.room = {};
      return true;
    }
    waiting_.resize(order_.size());
    for (size_t i = 0; i < order_.size(); ++i) waiting_[i] = static_cast<int32_t>(i);
    tried_ = 0;
    const auto size = static_cast<int64_t>(s_.vertices.size());
    const int64_t count = std::min<int64_t>(size / kBlock, static_cast<int64_t>(s_.live.size()) / kLeastBlock);
    if (count > 1) {
      const int64_t width = size / count + 1;
      for (const int64_t shift : {int64_t{0}, width / 2}) {  // what one division cuts the other does not
        start_blocks(static_cast<size_t>(count) + 1);
        for (int64_t b = 0; b <= count; ++b)
          blocks_[b].start(std::max<int64_t>(b * width - shift, 0), std::min((b + 1) * width - shift, size));
        for (const int32_t i : waiting_) blocks_[(order_[i] + shift) / width].todo.push_back(i);
        run_blocks(wanted);
      }
    }
    start_blocks(1);
    blocks_[0].start(0, size);
    blocks_[0].whole = true;
    blocks_[0].todo.swap(waiting_);
    run_blocks(wanted);
    blocks_[0].whole = false;
    return tried_ > 0;
  }

  // Lists anew, without those of dead vertices and without dead faces.
  void compact_corners() {
    std::vector<int32_t> items;
    std::vector<int64_t> start;
    for (const int32_t v : s_.live) {
      start.push_back(static_cast<int64_t>(items.size()));
      Around::each(s_, v, [&](const Spoke& spoke) { items.push_back(spoke.corner); });
    }
    start.push_back(static_cast<int64_t>(items.size()));
    s_.corners.start(static_cast<int64_t>(items.size()));
    for (size_t i = 0; i < s_.live.size(); ++i) {
      Vertex& a = s_.vertices[s_.live[i]];
      a.first = static_cast<int32_t>(start[i]), a.count = static_cast<int32_t>(start[i + 1] - start[i]);
      std::copy(items.begin() + start[i], items.begin() + start[i + 1], s_.corners.at(a));
    }
    for (Block& b : blocks_) b.room = {};
  }

  void start_blocks(size_t count) {
    block_count_ = count;
    if (blocks_.size() < count) blocks_.resize(count);
  }

  // Collapses what the blocks have to do; what has to wait comes to waiting_. Takes what went off `wanted`.
  void run_blocks(int64_t& wanted) {
    const auto tasks = std::max<int64_t>(static_cast<int64_t>(waiting_.size()), 1);
    pool_.run(static_cast<int>(block_count_), [&](int b) {
      thread_local Scratch w;
      Block& block = blocks_[b];
      block.budget = block.whole ? wanted : wanted * static_cast<int64_t>(block.todo.size()) / tasks;
      for (size_t n = 0; n < block.todo.size(); ++n) {
        if (block.whole && block.removed >= wanted) break;
        fetch(block, n);
        const int32_t i = block.todo[n];
        if (collapse(i, order_[i], block, w) == Outcome::wait) block.waiting.push_back(i);
      }
      if (!block.whole) go_on(block, w);
    });
    waiting_.clear();
    std::vector<const Notes*> notes;
    for (size_t b = 0; b < block_count_; ++b) {
      const Block& block = blocks_[b];
      waiting_.insert(waiting_.end(), block.waiting.begin(), block.waiting.end());
      wanted -= block.removed;
      s_.triangles -= block.removed;
      tried_ += block.done;  // links remove no triangle, and yet they are progress
      for (size_t k = 0; k < block.refused.size(); ++k) refused_[k] += block.refused[k], tried_ += block.refused[k];
      notes.push_back(&block.notes);
    }
    std::sort(waiting_.begin(), waiting_.end());
    if (options_.record) results_.append(notes);
  }

  // Evaluates what changed in the block, while it lies in the cache, and collapses what is as cheap as what was picked.
  void go_on(Block& block, Scratch& w) {
    const auto rank = static_cast<int32_t>(order_.size());
    for (size_t n = 0; n < block.changed.size() && block.removed + 2 <= block.budget; ++n) {
      const int32_t v = block.changed[n];
      if (s_.flags[v] & kDead || !(s_.candidates[v].todo & (kDirty | kRetry))) continue;
      if (!evaluation_.one(v, block.begin, block.end, w)) continue;
      if (s_.candidates[v].cost <= limit_) collapse(rank, v, block, w);
    }
  }

  // Asks for what the next collapses will need, in the order in which one leads to the other.
  void fetch(const Block& block, size_t n) const {
    const auto ends = [&](size_t ahead, const auto& body) {
      if (n + ahead >= block.todo.size()) return;
      const int32_t v = order_[block.todo[n + ahead]], u = s_.candidates[v].partner;
      body(s_.vertices[v]);
      if (block.has(u)) body(s_.vertices[u]);
    };
    ends(8, [](const Vertex& a) { __builtin_prefetch(&a); });
    ends(4, [&](const Vertex& a) { __builtin_prefetch(s_.corners.begin(a)); });
    ends(2, [&](const Vertex& a) {
      for (const int32_t* c = s_.corners.begin(a); c != s_.corners.end(a); ++c) __builtin_prefetch(&s_.faces[face_of(*c)]);
    });
  }

  // Makes v's collapse if all that it changes is inside the block; beside others no more than two faces may go.
  Outcome collapse(int32_t rank, int32_t v, Block& block, Scratch& w) {
    const Candidate& candidate = s_.candidates[v];
    if (s_.flags[v] & kDead || candidate.todo & (kDirty | kRetry)) return Outcome::touched;
    const int32_t owner = v;
    int32_t u = candidate.partner;
    if (!block.has(u)) return Outcome::wait;
    if (candidate.todo & kVanish) return block.whole ? vanish(rank, v, w, block) : Outcome::wait;
    Around& around = w.around;
    around.gather(s_, v, u);
    if (!block.whole && (around.shared > 2 || !around.inside(block.begin, block.end))) return Outcome::wait;
    if (around.shared > 2 && around.shared > block.budget - block.removed && block.removed > 0) return Outcome::touched;
    if (options_.keep_last && block.whole && s_.triangles - block.removed <= around.shared)
      return refuse(v, block, Stop::last);
    Vec3 x;
    float error;
    const Stop why = guard(&v, &u, w, &x, &error);
    if (why != Stop::triangles) return refuse(owner, block, why);
    const auto corners = static_cast<int32_t>(around.of_v.size() + around.of_u.size());
    const int32_t place = s_.corners.place(s_.vertices[v], s_.vertices[u], corners, block.room);
    if (place == kNone) {  // next time: the lists are compacted first
      ++block.done;
      return Outcome::touched;
    }
    apply(rank, v, u, x, error, place, w, block);
    block.removed += around.shared;
    ++block.done;
    return Outcome::done;
  }

  // What forbids the collapse (Stop::triangles: nothing does), and where it leads to: v is the vertex that stays then.
  Stop guard(int32_t* v, int32_t* u, Scratch& w, Vec3* x, float* error) const {
    if (keep_topology_ && !w.around.link_condition(*v, *u)) return Stop::topology;
    if (in_.locked && w.around.strands_locked(s_, *v, *u)) return Stop::locked;
    Vec3 y;
    const float cost = w.merge.place(s_, options_, *v, *u, &y);
    if (!(cost < kInfinity)) return w.merge.locked ? Stop::locked : Stop::seams;
    *error = std::max({s_.vertices[*v].error, s_.vertices[*u].error, w.merge.deviation});
    if (*error > max_error_) return Stop::error;
    if (w.merge.kept == *u) {
      std::swap(*v, *u);
      w.around.swap();
    }
    *x = s_.vertices[*v].p + y;
    return w.around.turns(s_, *v, *u, *x, options_.flip_cos) ? Stop::flip : Stop::triangles;
  }

  Outcome refuse(int32_t v, Block& block, Stop why) {
    ++block.refused[static_cast<size_t>(why)];
    ++s_.candidates[v].skip;
    s_.candidates[v].todo |= kRetry | kPassedOver;
    block.changed.push_back(v);
    return Outcome::refused;
  }

  void apply(int32_t rank, int32_t v, int32_t u, Vec3 x, float error, int32_t place, Scratch& w, Block& block) {
    Vertex &a = s_.vertices[v], &b = s_.vertices[u];
    const Around& around = w.around;
    Merge& m = w.merge;
    m.commit(s_, v, u, x - a.p, around);
    for (const Spoke& spoke : around.between) s_.faces[face_of(spoke.corner)].v[0] = kNone;
    a.first = place, a.count = static_cast<int32_t>(around.of_v.size() + around.of_u.size());
    int32_t* to = s_.corners.at(a);
    for (const Buffer<Spoke>* ring : {&around.of_v, &around.of_u})
      for (const Spoke& spoke : *ring) {
        s_.faces[face_of(spoke.corner)].v[slot_of(spoke.corner)] = v;
        *to++ = spoke.corner;
      }
    if (s_.columns) {
      rename_wedges(around.of_u, m.groups());
      if (m.groups().size() > 1 || (s_.flags[v] & kSeveralWedges)) rename_wedges(around.of_v, m.groups());
    }
    const bool irregular = (s_.flags[v] | s_.flags[u]) & kIrregular;  // else each neighbour comes next just once
    for (const Buffer<Spoke>* ring : {&around.of_v, &around.of_u, &around.between})
      for (const Spoke& spoke : *ring) {
        look_again(spoke.next, v, u, block);
        if (irregular || ring == &around.between) look_again(spoke.previous, v, u, block);
      }
    a.q = m.quadric;
    a.p = x;
    a.error = error;
    uint8_t& flags = s_.flags[v];
    flags &= static_cast<uint8_t>(~kSeveralWedges);
    flags |= (m.moved ? kMoved : 0) | (m.groups().size() > 1 ? kSeveralWedges : 0) | (s_.flags[u] & (kIrregular | kLocked));
    if (options_.follow) s_.vertex_into[u] = v;
    if (!s_.wedge_into.empty())
      for (const auto& [from, to] : m.groups().links()) s_.wedge_into[from] = to;
    s_.candidates[v].todo |= kDirty;
    block.changed.push_back(v);
    s_.flags[u] = kDead;
    b.count = 0;
    s_.candidates[u].cost = kInfinity;
    if (!a.count) flags |= kDead, s_.candidates[v].cost = kInfinity;
    if (options_.record) results_.note(rank, v, u, around.shared, m.groups().links(), block.notes);
  }

  // Merging only makes edges dearer: what a neighbour has found stays its best unless it led here.
  void look_again(int32_t neighbour, int32_t v, int32_t u, Block& block) {
    if (neighbour == kNone) return;
    Candidate& c = s_.candidates[neighbour];
    if (c.todo & kDirty || !(c.partner == u || c.partner == v || (c.todo & kPassedOver))) return;
    c.todo |= kDirty;
    block.changed.push_back(neighbour);
  }

  void rename_wedges(const Buffer<Spoke>& ring, const WedgeGroups& groups) {
    for (const Spoke& spoke : ring) {
      if (spoke.link()) continue;
      int32_t& w = s_.wedges[face_of(spoke.corner)].w[slot_of(spoke.corner)];
      w = groups.size() == 1 ? groups[0].wedge : groups.target(w);
    }
  }

  Outcome vanish(int32_t rank, int32_t v, Scratch& w, Block& block) {
    if (!evaluation_.gather_component(v, w.component)) {
      s_.candidates[v].todo |= kDirty;
      ++block.done;
      return Outcome::touched;
    }
    const float trace = s_.vertices[v].q.trace();
    const float error = trace > 0 ? std::sqrt(s_.candidates[v].cost / trace) : 0;
    if (error > max_error_) return refuse(v, block, Stop::error);
    int removed = 0;
    const auto each = [&](const auto& body) {
      for (const int32_t m : w.component) Around::each(s_, m, [&](const Spoke& spoke) { body(spoke.corner); });
    };
    each([&](int32_t corner) { removed += slot_of(corner) == 0; });
    if (options_.keep_last && s_.triangles - block.removed <= removed) return refuse(v, block, Stop::last);
    each([&](int32_t corner) { s_.faces[face_of(corner)].v[0] = kNone; });
    const int32_t last = w.component[w.component.size() - 1];
    for (const int32_t m : w.component) {
      s_.flags[m] = kDead;
      s_.candidates[m].cost = kInfinity;
      if (options_.record && m != v)  // no prefix may count the faces and keep some
        results_.note(rank, v, m, m == last ? removed : 0, {}, block.notes);
    }
    for (const int32_t m : w.component) s_.vertices[m].count = 0;
    block.removed += removed;
    ++block.done;
    return Outcome::done;
  }

  // ---------------------------------------------------------------- the end

  // Nothing can be collapsed under the guards: give up the link condition if that is allowed, else say what held.
  Stop stuck() {
    if (keep_topology_ && options_.may_relax && refused_[static_cast<size_t>(Stop::topology)]) {
      keep_topology_ = false;
      relaxed_ = true;
      refused_ = {};
      for (const int32_t v : s_.live) s_.flags[v] |= kIrregular, s_.candidates[v].todo |= kDirty;
      return Stop::triangles;
    }
    if (max_error_ < kInfinity && refused_[static_cast<size_t>(Stop::error)]) return Stop::error;
    if (refused_[static_cast<size_t>(Stop::last)]) return Stop::last;
    return holding();
  }

  // What forbids most of the collapses that are left, those included that were never candidates.
  Stop holding() {
    std::array<int64_t, kStops> count{};
    Scratch w;
    std::vector<int32_t> others;
    for (const int32_t lower : s_.live) {
      others.clear();
      Around::each(s_, lower, [&](const Spoke& spoke) {
        for (const int32_t n : {spoke.next, spoke.previous})
          if (n > lower && std::find(others.begin(), others.end(), n) == others.end()) others.push_back(n);
      });
      for (const int32_t other : others) {
        int32_t v = lower, u = other;
        Vec3 x;
        float error;
        w.around.gather(s_, v, u);
        ++count[static_cast<size_t>(guard(&v, &u, w, &x, &error))];
      }
    }
    Stop worst = Stop::topology;
    for (size_t k = static_cast<size_t>(Stop::topology); k <= static_cast<size_t>(Stop::locked); ++k)
      if (count[k] > count[static_cast<size_t>(worst)]) worst = static_cast<Stop>(k);
    return worst;
  }

  const Input& in_;
  const Options& options_;
  const std::function<bool(int64_t, int64_t)>& progress_;
  Pool pool_;
  State s_;
  Results results_;
  Evaluation evaluation_;
  CoarseRound coarse_round_;
  bool coarse_ = false;
  std::vector<float> sample_;
  std::vector<int32_t> order_;    // vertices whose candidates the round tries
  std::vector<int32_t> waiting_;  // rows of it
  std::vector<Block> blocks_;
  size_t block_count_ = 0;
  std::array<int64_t, kStops> refused_{};
  int64_t tried_ = 0;
  float limit_ = 0;  // cost of the dearest candidate that the round tries
  float max_error_ = kInfinity;
  bool keep_topology_ = true, relaxed_ = false;
};

}  // namespace

EdgeCosts edge_costs(const Input& input, const Options& options) {
  Pool pool(1);
  State s;
  prepare(input, options, pool, s);
  EdgeCosts out;
  Merge merge;
  std::vector<int32_t> others;
  for (int32_t v = 0; v < static_cast<int32_t>(s.vertices.size()); ++v) {
    others.clear();
    Around::each(s, v, [&](const Spoke& spoke) {
      for (const int32_t u : {spoke.next, spoke.previous})
        if (u > v) others.push_back(u);
    });
    std::sort(others.begin(), others.end());
    others.erase(std::unique(others.begin(), others.end()), others.end());
    for (const int32_t u : others) {
      Vec3 y;
      out.cost.push_back(merge.place(s, options, v, u, &y));
      out.edges.push_back(s.vertex_source[v]);
      out.edges.push_back(s.vertex_source[u]);
      const Vec3 x = s.vertices[merge.kept == u ? u : v].p + y;
      out.positions.push_back(s.center[0] + x.x / s.scale);
      out.positions.push_back(s.center[1] + x.y / s.scale);
      out.positions.push_back(s.center[2] + x.z / s.scale);
    }
  }
  return out;
}

Result decimate(const Input& input, const Options& options, const std::function<bool(int64_t, int64_t)>& progress) {
  return Decimator(input, options, progress).run();
}

}  // namespace lodpipe
