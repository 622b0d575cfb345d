// The loop (Liao 2004, section 3.1): the cheapest candidate, evaluated again if it is dirty, collapsed if it is clean.
#include "similarity.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "../parallel.h"
#include "cost.h"
#include "plan.h"
#include "queue.h"

namespace lodpipe::similarity {
namespace {

constexpr size_t kAhead = 4;            // costs a thread that are worked out at a time
constexpr int kGrain = 64;            // candidates a piece of parallel work
constexpr size_t kBetweenCalls = 2048;  // faces of regions that are looked at between two calls of `progress`
constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
constexpr double kNever = std::numeric_limits<double>::infinity();

struct Scratch {
  Collapse collapse;
  Planner::Scratch plan;
  CostScratch cost;
};

std::unique_ptr<Cost> make_cost(const Mesh& mesh, const Scene& scene, const Options& options) {
  switch (options.metric) {
    case Metric::texture_deviation: return make_deviation_cost(mesh, scene, options);
    case Metric::image: return make_image_cost(mesh, scene, options);
    default: return make_ray_cost(mesh, scene, options);
  }
}

// A half-edge from → to, or (full) the edge between them.
struct Candidate {
  int32_t from, to;
};

std::vector<Candidate> all_candidates(const Mesh& mesh, bool full) {
  std::vector<Candidate> out;
  std::vector<std::pair<int32_t, int>> near;
  for (int32_t v = 0; v < static_cast<int32_t>(mesh.p.size()); ++v) {
    mesh.neighbours(v, near);
    for (const auto& [u, faces] : near)
      if (!full || u > v) out.push_back({v, u});
  }
  return out;
}

class Simplifier {
 public:
  Simplifier(const Input& input, const Scene& scene, const Options& options,
             const std::function<bool(int64_t, int64_t)>& progress)
      : input_(input), options_(options), progress_(progress), mesh_(input), planner_(mesh_, options, scene),
        cost_(make_cost(mesh_, scene, options)), candidates_(all_candidates(mesh_, options.full)),
        touching_(mesh_.p.size()), queue_(candidates_.size()), ready_(candidates_.size(), kUnknown),
        pool_(std::max(options.threads, 1)), gone_(candidates_.size(), 0) {
    for (size_t i = 0; i < candidates_.size(); ++i)
      for (const int32_t v : {candidates_[i].from, candidates_[i].to}) touching_[v].push_back(static_cast<int32_t>(i));
    start_ = mesh_.triangles;
    last_ = input.targets.empty() ? 0 : input.targets.back();
  }

  Costs first_costs() {
    Costs out;
    for (const Candidate& candidate : candidates_) {
      double cost = kNever;
      Stop why;
      if (bool exists; (why = plan(candidate, scratch_, &exists)) == Stop::triangles) cost = evaluate(scratch_);
      const Collapse& c = scratch_.collapse;
      out.pairs.insert(out.pairs.end(), {c.gone, c.kept});
      out.cost.push_back(cost);
      const Point x = mesh_.center + c.place * (1 / mesh_.scale);
      out.places.insert(out.places.end(), {x.x, x.y, x.z});
    }
    return out;
  }

  Outcome run() {
    Stop stop = Stop::triangles;
    if (mesh_.triangles > last_ && !evaluate_all()) stop = Stop::cancelled;
    for (const int64_t target : input_.targets) {
      while (stop == Stop::triangles && mesh_.triangles > target) stop = step();
      mesh_.emit(target, mesh_.triangles <= target ? Stop::triangles : stop, relaxed_, error_, out_.result.levels);
    }
    return std::move(out_);
  }

 private:
  Stop plan(const Candidate& candidate, Scratch& s, bool* exists) const {
    return planner_.plan(candidate.from, candidate.to, s.collapse, s.plan, exists);
  }

  double evaluate(Scratch& s) const {
    const Collapse& c = s.collapse;
    double cost = cost_->evaluate(c, s.cost);
    if (input_.importance) {
      const float a = input_.importance[c.gone], b = input_.importance[c.kept];
      cost *= options_.full ? std::max(a, b) : a;
    }
    return std::isfinite(cost) ? cost : std::numeric_limits<double>::max();
  }

  // All costs, several threads at a time. False if the caller wants no more.
  bool evaluate_all() {
    std::vector<double> costs(candidates_.size(), kNever);
    size_t begin = 0;
    while (begin < candidates_.size()) {
      if (!progress_(0, start_ - last_)) return false;
      size_t end = begin;
      for (size_t work = 0; end < candidates_.size() && work < 8 * kBetweenCalls; ++end)
        work += mesh_.ring[candidates_[end].from].size();
      pool_.range(static_cast<int>(end - begin), kGrain, [&](int from, int to) {
        thread_local Scratch s;
        bool exists;
        for (size_t i = begin + from; i < begin + to; ++i)
          if (plan(candidates_[i], s, &exists) == Stop::triangles) costs[i] = evaluate(s);
      });
      begin = end;
    }
    for (size_t i = 0; i < costs.size(); ++i)
      if (costs[i] < kNever) queue_.set(static_cast<int32_t>(i), costs[i]), ++out_.evaluations;
    return true;
  }

  // Evaluates or collapses what is at the front.
  Stop step() {
    if (queue_.empty()) return refill();
    const int32_t id = queue_.front();
    bool exists;
    const Stop why = plan(candidates_[id], scratch_, &exists);
    work_ += scratch_.collapse.before.size() + 8;
    if (work_ > kBetweenCalls) {
      work_ = 0;
      if (!progress_(start_ - mesh_.triangles, start_ - last_)) return Stop::cancelled;
    }
    if (why != Stop::triangles) {
      queue_.remove(id);
      ++refused_[static_cast<size_t>(why)];
      if (!exists) gone_[id] = 1;
    } else if (queue_.dirty(id)) {
      ++out_.evaluations;
      // what a whole component costs may change without anything near the candidate: it is small, asked for at once
      if (!scratch_.collapse.whole && std::isnan(ready_[id])) prepare(id);
      queue_.set(id, scratch_.collapse.whole ? evaluate(scratch_) : ready_[id]);
    } else collapse(queue_.cost(id));
    return Stop::triangles;
  }

  // Costs of the candidate at the front and, with several threads, of dirty ones behind it, which are likely to be asked
  // for next. The order of collapses is the same: `soil` takes back what a collapse nearby has made out of date.
  void prepare(int32_t id) {
    batch_.assign(1, id);
    if (pool_.threads() > 1 && cost_->lasts()) {
      batch_.clear();
      queue_.ahead(kAhead * pool_.threads(), [&](int32_t i) { return queue_.dirty(i) && std::isnan(ready_[i]); }, batch_);
    }
    if (batch_.size() < 2) {
      ready_[id] = evaluate(scratch_);
      return;
    }
    pool_.run(static_cast<int>(batch_.size()), [&](int i) {
      thread_local Scratch s;
      bool exists;
      if (plan(candidates_[batch_[i]], s, &exists) == Stop::triangles) ready_[batch_[i]] = evaluate(s);
    });
  }

  void collapse(double cost) {
    const Collapse& c = scratch_.collapse;
    cost_->commit(c, scratch_.cost);
    error_ = std::max(error_, c.deviation);
    out_.costs.push_back(cost);
    refused_ = {};
    again_ = false;
    if (c.whole) return vanish();
    changed_.assign(1, c.kept);
    for (const int32_t f : c.before)
      for (const int32_t v : mesh_.faces[f].v)
        if (v != c.gone) changed_.push_back(v);
    planner_.merged(c);
    mesh_.apply(c);
    if (options_.record) mesh_.note(c, c.gone, static_cast<int>(c.removed.size()), error_, out_.result.record);
    rename(c.gone, c.kept);
    std::sort(changed_.begin(), changed_.end());
    changed_.erase(std::unique(changed_.begin(), changed_.end()), changed_.end());
    for (const int32_t v : changed_)
      for (const int32_t id : touching_[v])
        if (options_.full || candidates_[id].from == v) soil(id);
  }

  void soil(int32_t id) {
    queue_.soil(id);
    ready_[id] = kUnknown;
  }

  // The whole component goes.
  void vanish() {
    const Collapse& c = scratch_.collapse;
    changed_.clear();
    for (const int32_t f : c.removed) changed_.insert(changed_.end(), mesh_.faces[f].v, mesh_.faces[f].v + 3);
    std::sort(changed_.begin(), changed_.end());
    changed_.erase(std::unique(changed_.begin(), changed_.end()), changed_.end());
    const auto removed = static_cast<int>(c.removed.size());
    mesh_.vanish(c);
    size_t left = changed_.size() - 1;  // no prefix of the record may count the faces and keep some
    Collapse row;
    row.kept = c.kept;
    for (const int32_t v : changed_)
      if (options_.record && v != c.kept) mesh_.note(row, v, --left ? 0 : removed, error_, out_.result.record);
    for (const int32_t v : changed_) {
      for (const int32_t id : touching_[v]) queue_.remove(id), gone_[id] = 1;
      touching_[v].clear();
    }
  }

  // The candidates of `gone` are now those of `kept`; those between the two, and second ones, are no more.
  void rename(int32_t gone, int32_t kept) {
    for (const int32_t id : touching_[gone]) {
      if (gone_[id]) continue;
      Candidate& candidate = candidates_[id];
      const int32_t other = candidate.from == gone ? candidate.to : candidate.from;
      Candidate wanted{candidate.from == gone ? kept : candidate.from, candidate.to == gone ? kept : candidate.to};
      if (options_.full && wanted.from > wanted.to) std::swap(wanted.from, wanted.to);
      bool second = other == kept;
      for (const int32_t o : touching_[kept])
        second |= !gone_[o] && candidates_[o].from == wanted.from && candidates_[o].to == wanted.to;
      if (second) {
        queue_.remove(id);
        gone_[id] = 1;
        continue;
      }
      candidate = wanted;
      touching_[kept].push_back(id);
    }
    touching_[gone].clear();
    for (const int32_t v : changed_) std::erase_if(touching_[v], [&](int32_t id) { return gone_[id]; });
  }

  // Nothing is left in the queue: look at all once more, then give up the link condition if that is allowed.
  Stop refill() {
    if (again_) {
      if (planner_.topology != Topology::free && options_.may_relax && refused_[static_cast<size_t>(Stop::topology)])
        planner_.topology = Topology::free, relaxed_ = true;
      else return holding();
    }
    again_ = true;
    refused_ = {};
    bool any = false;
    for (size_t i = 0; i < candidates_.size(); ++i)
      if (!gone_[i]) soil(static_cast<int32_t>(i)), any = true;
    return any ? Stop::triangles : holding();
  }

  Stop holding() const {
    if (refused_[static_cast<size_t>(Stop::last)]) return Stop::last;
    Stop worst = Stop::topology;
    for (size_t k = static_cast<size_t>(Stop::topology); k <= static_cast<size_t>(Stop::locked); ++k)
      if (refused_[k] > refused_[static_cast<size_t>(worst)]) worst = static_cast<Stop>(k);
    return worst;
  }

  const Input& input_;
  const Options& options_;
  const std::function<bool(int64_t, int64_t)>& progress_;
  Mesh mesh_;
  Planner planner_;
  std::unique_ptr<Cost> cost_;
  std::vector<Candidate> candidates_;
  std::vector<std::vector<int32_t>> touching_;  // candidates at each vertex
  LazyQueue queue_;
  std::vector<double> ready_;  // costs of dirty candidates that are known before they come to the front
  std::vector<int32_t> batch_;
  Pool pool_;
  std::vector<uint8_t> gone_;  // candidates that are no more
  std::vector<int32_t> changed_;
  Scratch scratch_;
  Outcome out_;
  std::array<int64_t, kStops> refused_{};
  int64_t start_ = 0, last_ = 0;
  size_t work_ = 0;
  double error_ = 0;
  bool relaxed_ = false, again_ = false;
};

}  // namespace

Outcome simplify(const Input& input, const Scene& scene, const Options& options,
                 const std::function<bool(int64_t, int64_t)>& progress) {
  return Simplifier(input, scene, options, progress).run();
}

Costs costs(const Input& input, const Scene& scene, const Options& options) {
  return Simplifier(input, scene, options, [](int64_t, int64_t) { return true; }).first_costs();
}

}  // namespace lodpipe::similarity
