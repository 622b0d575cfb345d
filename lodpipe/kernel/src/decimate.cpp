// The loop: evaluate, pick, collapse, until the targets are met.
//
// A round evaluates what changed, picks the cheapest share of the candidates in order of cost, and collapses those
// whose two vertices were not yet touched in the round: their cost is still exact. Blocks of the Morton order are
// collapsed side by side; a collapse whose ring leaves its block waits for the others to end. Blocks depend on the mesh
// alone, so the result is the same for any number of threads.
#include "decimate.h"

#include <array>
#include <cmath>
#include <memory>
#include <numeric>

#include "merge.h"
#include "mesh_state.h"
#include "prepare.h"

namespace lodpipe {
namespace {

constexpr int kGrain = 512;              // vertices a piece of parallel work
constexpr int kBlocks = 16;
constexpr int kLeastBlock = 2048;        // live vertices
constexpr float kLeastQuality = 1e-3f;   // 2·area / longest edge², below which a new face is a sliver
constexpr size_t kSmallRing = 48;        // up to here a linear search beats sorting
constexpr size_t kSample = 4096;           // costs that are looked at to find a share's limit
constexpr size_t kFew = 64;
constexpr int kNext[3] = {1, 2, 0};

struct Neighbour {
  int32_t vertex;
  int32_t faces;  // triangles at the vertex that have it as a corner
};

// Working memory of one thread.
struct Scratch {
  Buffer<int32_t> owned, ring_v, ring_u, between, before;
  Buffer<Neighbour> near_v, near_u;
  Buffer<float> costs;
  Merge merge;
};

class Decimator {
 public:
  Decimator(const Input& in, const Options& options, const std::function<bool(int64_t, int64_t)>& progress)
      : in_(in), options_(options), progress_(progress), pool_(std::max(options.threads, 1)) {
    prepare(in_, options_, pool_, s_);
    keep_topology_ = options_.keep_topology;
    if (options_.follow) {
      s_.vertex_into.resize(s_.vertices.size());
      s_.wedge_into.resize(s_.wedge_source.size());
      std::iota(s_.vertex_into.begin(), s_.vertex_into.end(), 0);
      std::iota(s_.wedge_into.begin(), s_.wedge_into.end(), 0);
    }
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
      emit(target, s_.triangles <= target ? Stop::triangles : stop);
    }
    return std::move(result_);
  }

 private:
  // ---------------------------------------------------------------- evaluate

  // Calls body(corner, face) for the live faces round v; dead ones are taken out of the list on the way.
  template <class Body>
  void each_face(Vertex& v, const Body& body) {
    for (int32_t* link = &v.head; *link != kNone;) {
      const int32_t c = *link;
      Face& f = s_.faces[face_of(c)];
      int32_t& next = f.next[slot_of(c)];
      if (f.dead()) {
        *link = next;
        continue;
      }
      body(c, f);
      link = &next;
    }
  }

  // The cheapest collapse among the edges that v owns (those to vertices of a higher number).
  void evaluate(int32_t v, Scratch& w) {
    Vertex& a = s_.vertices[v];
    uint8_t& flags = s_.flags[v];
    if (flags & kDirty) a.skip = 0;
    flags &= static_cast<uint8_t>(~(kDirty | kRetry | kVanish));
    w.owned.clear();
    int faces = 0;
    if (flags & kIrregular) {
      each_face(a, [&](int32_t c, const Face& f) {
        ++faces;
        for (int k = 0; k < 3; ++k)
          if (f.v[k] > v && k != slot_of(c)) w.owned.push_back(f.v[k]);
      });
      std::sort(w.owned.begin(), w.owned.end());
      w.owned.resize(std::unique(w.owned.begin(), w.owned.end()) - w.owned.begin());
    } else {  // each neighbour follows v in just one face
      each_face(a, [&](int32_t c, const Face& f) {
        ++faces;
        const int32_t u = f.v[kNext[slot_of(c)]];
        if (u > v) w.owned.push_back(u);
      });
    }
    s_.cost[v] = kInfinity;
    s_.partner[v] = kNone;
    if (!faces) {
      flags |= kDead;
      return;
    }
    if (w.owned.empty()) return;
    if (faces < kVanishFaces && gather_component(v, w.before)) {
      flags |= kVanish;
      if (a.skip == 0) s_.cost[v] = vanishing_cost(w.before), s_.partner[v] = w.owned[0];
      return;
    }
    w.costs.resize(w.owned.size());
    w.merge.costs(s_, options_, v, w.owned, w.costs.data());
    if (a.skip >= static_cast<int32_t>(w.owned.size())) return;
    for (int n = 0;; ++n) {
      const auto best = std::min_element(w.costs.begin(), w.costs.end());
      if (n == a.skip) {
        if (*best < kInfinity) s_.cost[v] = *best, s_.partner[v] = w.owned[best - w.costs.begin()];
        return;
      }
      *best = kInfinity;
    }
  }

  // The vertices of v's component if it has at most kVanishFaces faces.
  bool gather_component(int32_t v, Buffer<int32_t>& members) const {
    members.clear();
    members.push_back(v);
    int faces = 0;
    for (size_t i = 0; i < members.size(); ++i) {
      int here = 0;
      for (int32_t c = s_.vertices[members[i]].head; c != kNone; c = s_.faces[face_of(c)].next[slot_of(c)]) {
        const Face& f = s_.faces[face_of(c)];
        if (f.dead()) continue;
        if (f.link() || ++here > kVanishFaces) return false;
        if (slot_of(c) == 0) ++faces;
        for (const int32_t u : f.v)
          if (std::find(members.begin(), members.end(), u) == members.end()) members.push_back(u);
      }
      if (members.size() > 4 || (s_.flags[members[i]] & kLocked)) return false;
    }
    return faces <= kVanishFaces;
  }

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

  // ---------------------------------------------------------------- pick

  // Fills order_ with the cheapest share of the candidates, at most `most`. Many come in the order of their place, which
  // the caches like and costs nothing that could be measured; few in the order of cost, so that the last ones are exact.
  void pick(size_t most) {
    order_.clear();
    sample_.clear();
    const size_t step = std::max<size_t>(1, s_.live.size() / kSample);
    size_t looked = 0;
    for (size_t i = 0; i < s_.live.size(); i += step, ++looked)
      if (s_.cost[s_.live[i]] < kInfinity) sample_.push_back(s_.cost[s_.live[i]]);
    float limit = std::numeric_limits<float>::max();
    const auto wanted = static_cast<size_t>(options_.round_share * static_cast<float>(looked));
    if (wanted + 1 < sample_.size()) {
      std::nth_element(sample_.begin(), sample_.begin() + static_cast<int64_t>(wanted), sample_.end());
      limit = sample_[wanted];
    }
    for (const int32_t v : s_.live)
      if (s_.cost[v] <= limit) order_.push_back(v);
    const auto cheaper = [&](int32_t a, int32_t b) { return s_.cost[a] != s_.cost[b] ? s_.cost[a] < s_.cost[b] : a < b; };
    if (order_.size() > most) {
      std::nth_element(order_.begin(), order_.begin() + static_cast<int64_t>(most), order_.end(), cheaper);
      order_.resize(most);
      std::sort(order_.begin(), order_.end());
    }
    if (order_.size() < kFew) std::sort(order_.begin(), order_.end(), cheaper);
  }

  // ---------------------------------------------------------------- collapse

  enum class Outcome { done, touched, wait, refused };

  struct Block {
    std::vector<int32_t> todo, waiting;  // rows of order_
    int64_t removed = 0, done = 0;  // triangles, collapses
    std::array<int64_t, kStops> refused{};
    std::unique_ptr<Scratch> scratch = std::make_unique<Scratch>();
    Record record;
    std::vector<int32_t> ranks;  // of the record's rows
  };

  // One round. False if nothing could be collapsed and nothing is left to be tried.
  bool round(int64_t wanted) {
    ++round_;
    pool_.range(static_cast<int>(s_.live.size()), kGrain, [&](int begin, int end) {
      thread_local Scratch w;
      for (int i = begin; i < end; ++i)
        if (s_.flags[s_.live[i]] & (kDirty | kRetry)) evaluate(s_.live[i], w);
    });
    s_.live.erase(std::remove_if(s_.live.begin(), s_.live.end(), [&](int32_t v) { return s_.flags[v] & kDead; }),
                  s_.live.end());
    // A collapse removes two triangles at most (others are left to the last part): so many cannot overshoot.
    pick(static_cast<size_t>(std::max<int64_t>(1, (wanted + 1) / 2)));
    if (order_.empty()) return false;
    const auto count = static_cast<int32_t>(order_.size());
    const int block_count =
        std::clamp(static_cast<int>(s_.live.size() / kLeastBlock), 1, kBlocks);
    blocks_.resize(kBlocks + 1);
    for (Block& b : blocks_) b.todo.clear(), b.waiting.clear(), b.removed = b.done = 0, b.refused = {}, b.record = {}, b.ranks.clear();
    Block& rest = blocks_[kBlocks];
    int32_t width = std::numeric_limits<int32_t>::max();
    if (block_count > 1) {
      width = static_cast<int32_t>(s_.vertices.size() / block_count + 1);
      for (int32_t i = 0; i < count; ++i) {
        const int32_t v = order_[i];
        const int32_t b = v / width;
        (s_.partner[v] / width == b ? blocks_[b].todo : rest.todo).push_back(i);
      }
      pool_.run(block_count, [&](int b) {
        for (const int32_t i : blocks_[b].todo)
          if (collapse(i, b, width, wanted, blocks_[b]) == Outcome::wait) blocks_[b].waiting.push_back(i);
      });
      for (int b = 0; b < block_count; ++b) {
        rest.todo.insert(rest.todo.end(), blocks_[b].waiting.begin(), blocks_[b].waiting.end());
        rest.removed += blocks_[b].removed;
      }
      std::sort(rest.todo.begin(), rest.todo.end());
    } else {
      for (int32_t i = 0; i < count; ++i) rest.todo.push_back(i);
    }
    for (const int32_t i : rest.todo)
      if (rest.removed < wanted) collapse(i, -1, width, wanted, rest);
    s_.triangles -= rest.removed;
    int64_t tried = 0;  // links remove no triangle, and yet they are progress
    for (const Block& b : blocks_) {
      tried += b.done;
      for (size_t k = 0; k < b.refused.size(); ++k) refused_[k] += b.refused[k], tried += b.refused[k];
    }
    merge_records();
    return tried > 0;
  }

  // Collapses candidate `i`. block < 0: anything goes; else only what stays inside the block and removes two faces.
  Outcome collapse(int32_t i, int block, int32_t width, int64_t wanted, Block& out) {
    int32_t v = order_[i], u = s_.partner[v];
    if (s_.stamp[v] == round_ || s_.stamp[u] == round_ || ((s_.flags[v] | s_.flags[u]) & kDead)) return Outcome::touched;
    Scratch& w = *out.scratch;
    if (s_.flags[v] & kVanish) {
      if (block >= 0) return Outcome::wait;
      return vanish(i, v, w, out);
    }
    const int shared = surround(v, u, w);
    if (block >= 0 && !(inside(w.near_v, block, width) && inside(w.near_u, block, width))) return Outcome::wait;
    if (block >= 0 && shared > 2) return Outcome::wait;
    if (shared > 2 && shared > wanted - out.removed && out.removed > 0) return Outcome::touched;
    if (options_.keep_last && block < 0 && s_.triangles - out.removed <= shared) return refuse(order_[i], out, Stop::last);
    Vec3 x;
    float error;
    const Stop why = guard(&v, &u, shared, w, &x, &error);
    if (why != Stop::triangles) return refuse(order_[i], out, why);
    apply(i, v, u, x, error, w, out);
    s_.stamp[v] = s_.stamp[u] = round_;
    out.removed += shared;
    ++out.done;
    return Outcome::done;
  }

  // Gathers what lies round v and u, faces on the edge apart from those that stay; the number of the former.
  int surround(int32_t v, int32_t u, Scratch& w) {
    gather_ring(v, w.ring_v, w.near_v);
    gather_ring(u, w.ring_u, w.near_u);
    w.between.clear();
    split(w.ring_v, u, &w.between);
    split(w.ring_u, v, nullptr);
    int shared = 0;
    for (const int32_t c : w.between) shared += !s_.faces[face_of(c)].link();
    return shared;
  }

  // What forbids the collapse (Stop::triangles: nothing does), and where it leads to: v is the vertex that stays then.
  Stop guard(int32_t* v, int32_t* u, int shared, Scratch& w, Vec3* x, float* error) const {
    if (keep_topology_ && !link_condition(*v, *u, shared, w)) return Stop::topology;
    if (in_.locked && strands_locked(*v, *u, w)) return Stop::locked;
    Vec3 y;
    const float cost = w.merge.place(s_, options_, *v, *u, &y);
    if (!(cost < kInfinity)) return w.merge.locked ? Stop::locked : Stop::seams;
    *error = std::max({s_.vertices[*v].error, s_.vertices[*u].error, w.merge.deviation});
    if (*error > max_error_) return Stop::error;
    if (w.merge.kept == *u) {
      std::swap(*v, *u);
      std::swap(w.ring_v, w.ring_u);
      std::swap(w.near_v, w.near_u);
    }
    *x = s_.vertices[*v].p + y;
    return turns(w.ring_v, *v, *x) || turns(w.ring_u, *u, *x) ? Stop::flip : Stop::triangles;
  }

  // Would a locked vertex lose its last face?
  bool strands_locked(int32_t v, int32_t u, const Scratch& w) const {
    const auto stays = [&](int32_t c) {
      const Face& f = s_.faces[face_of(c)];
      return !f.dead() && !f.link() && !(has(f, v) && has(f, u));
    };
    if ((s_.flags[v] | s_.flags[u]) & kLocked && std::none_of(w.ring_v.begin(), w.ring_v.end(), stays) &&
        std::none_of(w.ring_u.begin(), w.ring_u.end(), stays))
      return true;
    for (const int32_t between : w.between) {
      const Face& f = s_.faces[face_of(between)];
      if (f.link()) continue;
      const int32_t opposite = f.v[0] + f.v[1] + f.v[2] - u - v;
      if (!(s_.flags[opposite] & kLocked)) continue;
      int32_t c = s_.vertices[opposite].head;
      while (c != kNone && !stays(c)) c = s_.faces[face_of(c)].next[slot_of(c)];
      if (c == kNone) return true;
    }
    return false;
  }

  Outcome refuse(int32_t v, Block& out, Stop why) {
    ++out.refused[static_cast<size_t>(why)];
    ++s_.vertices[v].skip;
    s_.flags[v] |= kRetry;
    return Outcome::refused;
  }

  static bool has(const Face& f, int32_t v) { return f.v[0] == v || f.v[1] == v || f.v[2] == v; }

  bool inside(const Buffer<Neighbour>& near, int block, int32_t width) const {
    for (const Neighbour& n : near)
      if (n.vertex / width != block) return false;
    return true;
  }

  // Live corners of v, and its neighbours with the number of triangles that each shares with it.
  void gather_ring(int32_t v, Buffer<int32_t>& ring, Buffer<Neighbour>& near) {
    ring.clear();
    near.clear();
    const bool regular = !(s_.flags[v] & kIrregular);
    each_face(s_.vertices[v], [&](int32_t c, const Face& f) {
      ring.push_back(c);
      if (regular) {
        near.push_back({f.v[kNext[slot_of(c)]], 2});
        return;
      }
      for (const int32_t u : f.v)
        if (u != v && u != kNone) near.push_back({u, !f.link()});
    });
    if (regular && near.size() <= kSmallRing) return;
    std::sort(near.begin(), near.end(), [](const Neighbour& a, const Neighbour& b) { return a.vertex < b.vertex; });
    if (regular) return;
    size_t kept = 0;
    for (size_t i = 0; i < near.size(); ++i)
      if (kept && near[kept - 1].vertex == near[i].vertex) near[kept - 1].faces += near[i].faces;
      else near[kept++] = near[i];
    near.resize(kept);
  }

  // Takes the corners of faces that have `other` out of the ring.
  void split(Buffer<int32_t>& ring, int32_t other, Buffer<int32_t>* out) const {
    size_t kept = 0;
    for (const int32_t c : ring)
      if (!has(s_.faces[face_of(c)], other)) ring[kept++] = c;
      else if (out) out->push_back(c);
    ring.resize(kept);
  }

  static const Neighbour* find(const Buffer<Neighbour>& near, int32_t v) {
    if (near.size() <= kSmallRing) {
      for (const Neighbour& n : near)
        if (n.vertex == v) return &n;
      return nullptr;
    }
    auto it = std::lower_bound(near.begin(), near.end(), v, [](const Neighbour& n, int32_t x) { return n.vertex < x; });
    return it != near.end() && it->vertex == v ? &*it : nullptr;
  }

  // The vertices adjacent to both ends are just those opposite to the edge in its faces (Dey et al. 1999), and two
  // boundaries are not pinched together.
  bool link_condition(int32_t v, int32_t u, int shared, Scratch& w) const {
    size_t common = 0;
    for (const Neighbour& n : w.near_u) {  // along edges: links do not hold a surface together
      const Neighbour* other = n.faces ? find(w.near_v, n.vertex) : nullptr;
      common += other && other->faces;
    }
    w.before.clear();
    for (const int32_t c : w.between) {
      const Face& f = s_.faces[face_of(c)];
      if (f.link()) continue;
      const int32_t opposite = f.v[0] + f.v[1] + f.v[2] - u - v;
      if (std::find(w.before.begin(), w.before.end(), opposite) == w.before.end()) w.before.push_back(opposite);
    }
    if (common != w.before.size()) return false;
    if (shared == 1) return true;
    const auto on_boundary = [](const Buffer<Neighbour>& near) {
      return std::any_of(near.begin(), near.end(), [](const Neighbour& n) { return n.faces == 1; });
    };
    return !(on_boundary(w.near_v) && on_boundary(w.near_u));
  }

  // Would a face of `ring` turn over, or become a sliver, when its corner `moving` goes to x?
  bool turns(const Buffer<int32_t>& ring, int32_t moving, Vec3 x) const {
    const Vec3 p = s_.vertices[moving].p;
    const Vec3* q[4];
    const Vec3* r[4];
    int count = 0;
    for (size_t i = 0; i < ring.size(); ++i) {
      const Face& f = s_.faces[face_of(ring[i])];
      if (!f.link()) {
        const int k = kNext[slot_of(ring[i])];
        q[count] = &s_.vertices[f.v[k]].p, r[count] = &s_.vertices[f.v[kNext[k]]].p;
        ++count;
      }
      if (count == 4 || (i + 1 == ring.size() && count)) {
        for (int k = count; k < 4; ++k) q[k] = q[0], r[k] = r[0];
        if (four_turn(p, x, q, r)) return true;
        count = 0;
      }
    }
    return false;
  }

  // The same for the triangles (p → x, q, r) in the lanes of a vector.
  bool four_turn(Vec3 p, Vec3 x, const Vec3* const* q, const Vec3* const* r) const {
    const Lanes qx{q[0]->x, q[1]->x, q[2]->x, q[3]->x}, qy{q[0]->y, q[1]->y, q[2]->y, q[3]->y},
        qz{q[0]->z, q[1]->z, q[2]->z, q[3]->z};
    const Lanes rx{r[0]->x, r[1]->x, r[2]->x, r[3]->x}, ry{r[0]->y, r[1]->y, r[2]->y, r[3]->y},
        rz{r[0]->z, r[1]->z, r[2]->z, r[3]->z};
    const Lanes ex = rx - qx, ey = ry - qy, ez = rz - qz;
    const Lanes ox = p.x - qx, oy = p.y - qy, oz = p.z - qz, nx = x.x - qx, ny = x.y - qy, nz = x.z - qz;
    const Lanes ax = ey * oz - ez * oy, ay = ez * ox - ex * oz, az = ex * oy - ey * ox;
    const Lanes bx = ey * nz - ez * ny, by = ez * nx - ex * nz, bz = ex * ny - ey * nx;
    const Lanes before = ax * ax + ay * ay + az * az, after = bx * bx + by * by + bz * bz;
    const Lanes cosine = ax * bx + ay * by + az * bz;
    const Lanes tx = x.x - rx, ty = x.y - ry, tz = x.z - rz, sx = p.x - rx, sy = p.y - ry, sz = p.z - rz;
    const auto most = [](Lanes a, Lanes b) { return a > b ? a : b; };
    const Lanes base = ex * ex + ey * ey + ez * ez;
    const Lanes longest = most(most(base, nx * nx + ny * ny + nz * nz), tx * tx + ty * ty + tz * tz);
    const Lanes longest_before = most(most(base, ox * ox + oy * oy + oz * oz), sx * sx + sy * sy + sz * sz);
    const Lanes size = longest * longest, size_before = longest_before * longest_before;
    // a sliver, and it was none before; or over the limit of the turn
    const auto sliver = (after < kLeastQuality * kLeastQuality * size) & (after * size_before < 0.25f * before * size);
    const auto turned = (before > 1e-12f * size) &
                        ((cosine <= 0) | (cosine * cosine < options_.flip_cos * options_.flip_cos * before * after));
    const auto bad = sliver | turned;
    return bad[0] | bad[1] | bad[2] | bad[3];
  }

  void apply(int32_t rank, int32_t v, int32_t u, Vec3 x, float error, Scratch& w, Block& out) {
    Vertex &a = s_.vertices[v], &b = s_.vertices[u];
    w.merge.commit(s_, v, u, x - a.p);
    const Merge& m = w.merge;
    int removed = 0;
    for (const int32_t c : w.between) {
      Face& f = s_.faces[face_of(c)];
      removed += !f.link();
      f.v[0] = kNone;
    }
    int32_t* link = &a.head;
    const auto keep = [&](int32_t c) {
      Face& f = s_.faces[face_of(c)];
      f.v[slot_of(c)] = v;
      *link = c;
      link = &f.next[slot_of(c)];
    };
    for (const int32_t c : w.ring_v) keep(c);
    for (const int32_t c : w.ring_u) keep(c);
    *link = kNone;
    if (s_.columns) {
      rename_wedges(w.ring_u, m);
      if (m.groups() > 1 || (s_.flags[v] & kSeveralWedges)) rename_wedges(w.ring_v, m);
    }
    // an edge belongs to its lower end: above v nothing changed but for those whose partner is gone
    for (const auto* near : {&w.near_v, &w.near_u})
      for (const Neighbour& n : *near) {
        if (n.vertex < v || s_.partner[n.vertex] == u || s_.vertices[n.vertex].skip) s_.flags[n.vertex] |= kDirty;
      }
    a.q = m.quadric;
    a.p = x;
    a.error = error;
    uint8_t& flags = s_.flags[v];
    flags &= static_cast<uint8_t>(~kSeveralWedges);
    flags |= kDirty | (m.moved ? kMoved : 0) | (m.groups() > 1 ? kSeveralWedges : 0) | (s_.flags[u] & (kIrregular | kLocked));
    if (options_.follow) {
      s_.vertex_into[u] = v;
      for (const auto& [from, to] : m.links()) s_.wedge_into[from] = to;
    }
    s_.flags[u] = kDead;
    b.head = kNone;
    s_.cost[u] = kInfinity;
    if (a.head == kNone) flags |= kDead, s_.cost[v] = kInfinity;
    if (options_.record) note(rank, v, u, removed, m, out);
  }

  void rename_wedges(const Buffer<int32_t>& ring, const Merge& m) {
    for (const int32_t c : ring) {
      if (s_.faces[face_of(c)].link()) continue;
      int32_t& w = s_.wedges[face_of(c)].w[slot_of(c)];
      w = m.target(w);
    }
  }

  Outcome vanish(int32_t rank, int32_t v, Scratch& w, Block& out) {
    if (!gather_component(v, w.before)) {
      s_.flags[v] |= kDirty;
      ++out.done;
      return Outcome::touched;
    }
    Vertex& a = s_.vertices[v];
    const float trace = a.q.trace();
    const float error = trace > 0 ? std::sqrt(s_.cost[v] / trace) : 0;
    if (error > max_error_) return refuse(v, out, Stop::error);
    int removed = 0;
    const auto each = [&](const auto& body) {
      for (const int32_t m : w.before)
        for (int32_t c = s_.vertices[m].head; c != kNone; c = s_.faces[face_of(c)].next[slot_of(c)])
          if (Face& f = s_.faces[face_of(c)]; !f.dead()) body(f, slot_of(c));
    };
    each([&](const Face&, int slot) { removed += slot == 0; });
    if (options_.keep_last && s_.triangles - out.removed <= removed) return refuse(v, out, Stop::last);
    each([](Face& f, int) { f.v[0] = kNone; });
    const int32_t last = w.before[w.before.size() - 1];
    for (const int32_t m : w.before) {
      s_.flags[m] = kDead;
      s_.cost[m] = kInfinity;
      s_.stamp[m] = round_;
      if (options_.record && m != v) {
        Merge none;
        none.reset();
        note(rank, v, m, m == last ? removed : 0, none, out);  // no prefix may count them and keep some
      }
    }
    s_.vertices[v].head = kNone;
    out.removed += removed;
    ++out.done;
    return Outcome::done;
  }

  // ---------------------------------------------------------------- results

  void note(int32_t rank, int32_t v, int32_t u, int removed, const Merge& m, Block& out) {
    Record& r = out.record;
    const auto row = static_cast<int32_t>(r.removed.size());
    out.ranks.push_back(rank);
    r.removed.push_back(u);
    r.kept.push_back(v);
    r.triangles.push_back(removed);
    r.error.push_back(s_.vertices[v].error);
    for (const double c : world(v)) r.positions.push_back(c);
    for (const auto& [from, to] : m.links()) {
      r.wedge_event.push_back(row);
      r.wedge_from.push_back(from);
      r.wedge_to.push_back(to);
      const size_t at = r.wedge_values.size();
      r.wedge_values.resize(at + s_.columns);
      values_of(to, r.wedge_values.data() + at);
    }
  }

  // Rows of all blocks in the order in which one thread would have picked them; within a round they do not overlap.
  void merge_records() {
    if (!options_.record) return;
    struct Row {
      int32_t rank, block, row;
    };
    std::vector<Row> rows;
    std::vector<std::vector<int32_t>> first(blocks_.size());
    for (size_t b = 0; b + 1 < blocks_.size(); ++b)
      for (size_t i = 0; i < blocks_[b].ranks.size(); ++i)
        rows.push_back({blocks_[b].ranks[i], static_cast<int32_t>(b), static_cast<int32_t>(i)});
    std::sort(rows.begin(), rows.end(), [](const Row& a, const Row& b) { return a.rank != b.rank ? a.rank < b.rank : a.row < b.row; });
    for (size_t i = 0; i < blocks_.back().ranks.size(); ++i)
      rows.push_back({0, static_cast<int32_t>(blocks_.size()) - 1, static_cast<int32_t>(i)});
    for (size_t b = 0; b < blocks_.size(); ++b) {
      first[b].assign(blocks_[b].ranks.size() + 1, 0);
      for (const int32_t e : blocks_[b].record.wedge_event) ++first[b][static_cast<size_t>(e) + 1];
      for (size_t i = 0; i + 1 < first[b].size(); ++i) first[b][i + 1] += first[b][i];
    }
    Record& out = result_.record;
    for (const Row& at : rows) {
      const Record& r = blocks_[at.block].record;
      const auto event = static_cast<int32_t>(out.removed.size());
      out.removed.push_back(s_.vertex_source[r.removed[at.row]]);
      out.kept.push_back(s_.vertex_source[r.kept[at.row]]);
      out.triangles.push_back(r.triangles[at.row]);
      out.error.push_back(static_cast<float>(r.error[at.row] / s_.scale));
      for (int k = 0; k < 3; ++k) out.positions.push_back(r.positions[3 * static_cast<size_t>(at.row) + k]);
      for (int32_t e = first[at.block][at.row]; e < first[at.block][at.row + 1]; ++e) {
        out.wedge_event.push_back(event);
        out.wedge_from.push_back(s_.wedge_source[r.wedge_from[e]]);
        out.wedge_to.push_back(s_.wedge_source[r.wedge_to[e]]);
        const auto values = r.wedge_values.begin() + static_cast<int64_t>(e) * s_.columns;
        out.wedge_values.insert(out.wedge_values.end(), values, values + s_.columns);
      }
    }
  }

  // Nothing can be collapsed under the guards: give up the link condition if that is allowed, else say what held.
  Stop stuck() {
    if (keep_topology_ && options_.may_relax && refused_[static_cast<size_t>(Stop::topology)]) {
      keep_topology_ = false;
      relaxed_ = true;
      refused_ = {};
      for (const int32_t v : s_.live) s_.flags[v] |= kDirty | kIrregular;
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
      gather_ring(lower, w.ring_v, w.near_v);
      others.clear();
      for (const Neighbour& n : w.near_v)
        if (n.vertex > lower) others.push_back(n.vertex);
      for (const int32_t other : others) {
        int32_t v = lower, u = other;
        Vec3 x;
        float error;
        const int shared = surround(v, u, w);
        ++count[static_cast<size_t>(guard(&v, &u, shared, w, &x, &error))];
      }
    }
    Stop worst = Stop::topology;
    for (size_t k = static_cast<size_t>(Stop::topology); k <= static_cast<size_t>(Stop::locked); ++k)
      if (count[k] > count[static_cast<size_t>(worst)]) worst = static_cast<Stop>(k);
    return worst;
  }

  std::array<double, 3> world(int32_t v) const {
    const Vertex& a = s_.vertices[v];
    if (!(s_.flags[v] & kMoved)) {
      const double* p = in_.positions + 3 * static_cast<int64_t>(s_.vertex_source[v]);
      return {p[0], p[1], p[2]};
    }
    return {s_.center[0] + a.p.x / s_.scale, s_.center[1] + a.p.y / s_.scale, s_.center[2] + a.p.z / s_.scale};
  }

  void emit(int64_t target, Stop stop) {
    Level level;
    level.target = target;
    level.stop = stop;
    level.relaxed = relaxed_;
    std::vector<int32_t> number(s_.vertices.size(), kNone), wedge_number(s_.wedge_source.size(), kNone);
    float error = 0;
    const size_t count = static_cast<size_t>(s_.triangles);
    level.faces.reserve(3 * count), level.wedges.reserve(3 * count), level.face_source.reserve(count);
    for (size_t i = 0; i < s_.wedges.size(); ++i) {
      const Face& f = s_.faces[i];
      const Wedges& wedges = s_.wedges[i];
      if (f.dead()) continue;
      level.face_source.push_back(f.source);
      for (int k = 0; k < 3; ++k) {
        int32_t& n = number[f.v[k]];
        if (n == kNone) {
          n = static_cast<int32_t>(level.vertex_source.size());
          const Vertex& a = s_.vertices[f.v[k]];
          error = std::max(error, a.error);
          level.vertex_source.push_back(s_.flags[f.v[k]] & kMoved ? kNone : s_.vertex_source[f.v[k]]);
          for (const double c : world(f.v[k])) level.positions.push_back(c);
        }
        level.faces.push_back(n);
        int32_t& w = wedge_number[wedges.w[k]];
        if (w == kNone) {
          w = static_cast<int32_t>(level.wedge_source.size());
          emit_wedge(wedges.w[k], level);
        }
        level.wedges.push_back(w);
      }
    }
    level.error = error / s_.scale;
    if (options_.follow) {
      level.vertex_to = followed(s_.vertex_into, s_.vertex_source, number, in_.vertex_count);
      level.wedge_to = followed(s_.wedge_into, s_.wedge_source, wedge_number, in_.wedge_count);
    }
    result_.levels.push_back(std::move(level));
  }

  // For each row of the input, the level's number of what it was merged into.
  static std::vector<int32_t> followed(std::vector<int32_t>& into, const std::vector<int32_t>& source,
                                       const std::vector<int32_t>& number, int rows) {
    std::vector<int32_t> out(rows, kNone);
    for (size_t i = 0; i < into.size(); ++i) {
      auto last = static_cast<int32_t>(i);
      while (into[last] != last) last = into[last] = into[into[last]];  // the path gets half as long
      out[source[i]] = number[last];
    }
    return out;
  }

  void emit_wedge(int32_t w, Level& level) const {
    const bool moved = s_.columns && s_.wedge_moved[w];
    level.wedge_source.push_back(moved ? kNone : s_.wedge_source[w]);
    const size_t row = level.values.size();
    level.values.resize(row + s_.columns);
    values_of(w, level.values.data() + row);
  }

  // A wedge's values in the input's order and scale; to the last bit the input's while it was not moved.
  void values_of(int32_t w, float* out) const {
    const bool moved = s_.columns && s_.wedge_moved[w];
    for (int k = 0; k < s_.columns; ++k)
      out[s_.column_source[k]] =
          moved ? s_.value[static_cast<size_t>(w) * s_.columns + k] / s_.column_scale[k]
                : in_.values[static_cast<size_t>(s_.wedge_source[w]) * s_.columns + s_.column_source[k]];
  }

  const Input& in_;
  const Options& options_;
  const std::function<bool(int64_t, int64_t)>& progress_;
  Pool pool_;
  State s_;
  Result result_;
  std::vector<float> sample_;
  std::vector<int32_t> order_;
  std::vector<Block> blocks_;
  std::array<int64_t, kStops> refused_{};
  int32_t round_ = 0;
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
    for (int32_t c = s.vertices[v].head; c != kNone; c = s.faces[face_of(c)].next[slot_of(c)])
      for (const int32_t u : s.faces[face_of(c)].v)
        if (u > v) others.push_back(u);
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
