// A priority queue whose entries may be dirty: their cost is out of date, and is worked out again only when they come
// to the front (lazy evaluation; Cohen, Manocha & Olano 1997).
#pragma once
#include <algorithm>
#include <cstdint>
#include <vector>

namespace lodpipe::similarity {

class LazyQueue {
 public:
  explicit LazyQueue(size_t count) : cost_(count, 0), place_(count, kAbsent), dirty_(count, 0) {}

  bool empty() const { return heap_.empty(); }
  size_t size() const { return heap_.size(); }
  int32_t front() const { return heap_[0]; }
  bool dirty(int32_t id) const { return dirty_[id]; }
  bool has(int32_t id) const { return place_[id] != kAbsent; }
  double cost(int32_t id) const { return cost_[id]; }

  // Adds entries that are `wanted`, in order, until there are `most`, or after a hundred others.
  template <class Wanted>
  void ahead(size_t most, const Wanted& wanted, std::vector<int32_t>& out) {
    size_t others = 0;
    const auto later = [&](int32_t a, int32_t b) { return before(heap_[b], heap_[a]); };
    walk_.assign(heap_.empty() ? 0 : 1, 0);
    while (!walk_.empty() && out.size() < most && others < 100) {
      std::pop_heap(walk_.begin(), walk_.end(), later);
      const int32_t at = walk_.back(), count = static_cast<int32_t>(heap_.size());
      walk_.pop_back();
      if (wanted(heap_[at])) out.push_back(heap_[at]);
      else ++others;
      for (const int32_t child : {2 * at + 1, 2 * at + 2})
        if (child < count) walk_.push_back(child), std::push_heap(walk_.begin(), walk_.end(), later);
    }
  }

  // Puts the entry in, or moves it to its new cost: clean.
  void set(int32_t id, double cost) {
    cost_[id] = cost;
    dirty_[id] = 0;
    if (!has(id)) place_[id] = static_cast<int32_t>(heap_.size()), heap_.push_back(id);
    up(place_[id]);
    down(place_[id]);
  }
  // Marks the entry; one that is not in the queue comes in with its last cost.
  void soil(int32_t id) {
    if (!has(id)) set(id, cost_[id]);
    dirty_[id] = 1;
  }
  void remove(int32_t id) {
    if (!has(id)) return;
    const int32_t at = place_[id], last = heap_.back();
    heap_.pop_back();
    place_[id] = kAbsent;
    if (last == id) return;
    heap_[at] = last, place_[last] = at;
    up(at);
    down(place_[last]);
  }

 private:
  static constexpr int32_t kAbsent = -1;
  bool before(int32_t a, int32_t b) const { return cost_[a] != cost_[b] ? cost_[a] < cost_[b] : a < b; }
  void put(int32_t at, int32_t id) { heap_[at] = id, place_[id] = at; }
  void up(int32_t at) {
    const int32_t id = heap_[at];
    for (int32_t parent; at > 0 && before(id, heap_[parent = (at - 1) / 2]); at = parent) put(at, heap_[parent]);
    put(at, id);
  }
  void down(int32_t at) {
    const int32_t id = heap_[at], count = static_cast<int32_t>(heap_.size());
    for (int32_t child; (child = 2 * at + 1) < count; at = child) {
      if (child + 1 < count && before(heap_[child + 1], heap_[child])) ++child;
      if (!before(heap_[child], id)) break;
      put(at, heap_[child]);
    }
    put(at, id);
  }

  std::vector<double> cost_;
  std::vector<int32_t> place_, heap_, walk_;
  std::vector<uint8_t> dirty_;
};

}  // namespace lodpipe::similarity
