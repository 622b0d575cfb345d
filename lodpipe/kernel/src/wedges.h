// Which wedges of two vertices become one when the vertices do.
#pragma once
#include <algorithm>
#include <utility>

#include "around.h"
#include "mesh_state.h"

namespace lodpipe {

class WedgeGroups {
 public:
  struct Member {
    int32_t wedge, group;
    bool of_u;
  };
  struct Group {
    int32_t wedge;  // the one that stays
    int32_t of_v;   // how many wedges of v are in it
  };

  void clear() { members_.clear(), groups_.clear(), links_.clear(); }
  bool empty() const { return groups_.empty(); }
  size_t size() const { return groups_.size(); }
  const Buffer<Member>& members() const { return members_; }
  const Group& operator[](size_t i) const { return groups_[i]; }

  // Those that a face on the edge joins become one, the others stay apart. A wedge of v stands for its group if there is
  // one. Without links, vertices of one wedge each have one group.
  void find(const State& s, int32_t v, int32_t u) {
    clear();
    const bool several = (s.flags[v] | s.flags[u]) & kSeveralWedges;
    if (!several && !s.has_links) {  // by far the most
      members_.push_back({first_wedge(s, v), 0, false});
      members_.push_back({first_wedge(s, u), 0, true});
      groups_.push_back({members_[0].wedge, 1});
      return;
    }
    for (const bool of_u : {false, true})
      Around::each(s, of_u ? u : v, [&](const Spoke& spoke) {
        if (spoke.link()) return;
        const int32_t* w = s.wedges[face_of(spoke.corner)].w;
        const int k = slot_of(spoke.corner);
        const int32_t mine = add(w[k], of_u);
        if (!of_u) return;
        if (spoke.next == v) join(members_[mine].group, members_[row_of(w[kNext[k]])].group);
        if (spoke.previous == v) join(members_[mine].group, members_[row_of(w[kNext[kNext[k]]])].group);
      });
    number_groups();
  }

  // The wedge of a vertex that has just one.
  static int32_t first_wedge(const State& s, int32_t v) {
    const int32_t* c = s.corners.begin(s.vertices[v]);
    while (s.faces[face_of(*c)].dead()) ++c;
    return s.wedges[face_of(*c)].w[slot_of(*c)];
  }

  // Group of a wedge of v or u, or kNone.
  int32_t group_of(int32_t wedge) const {
    const int32_t row = row_of(wedge);
    return row == kNone ? kNone : members_[row].group;
  }

  // The wedge that stands for `wedge` after the collapse.
  int32_t target(int32_t wedge) const {
    const int32_t group = group_of(wedge);
    return group == kNone ? wedge : groups_[group].wedge;
  }

  // Fills links(): pairs of wedges, gone and kept; with `changed` also the kept ones that nothing joined, twice.
  void link_up(bool changed) {
    joined_.resize(groups_.size());
    std::fill(joined_.begin(), joined_.end(), uint8_t{0});
    links_.clear();
    for (const Member& m : members_)
      if (m.wedge != groups_[m.group].wedge) links_.push_back({m.wedge, groups_[m.group].wedge}), joined_[m.group] = 1;
    for (size_t i = 0; changed && i < groups_.size(); ++i)
      if (!joined_[i]) links_.push_back({groups_[i].wedge, groups_[i].wedge});
  }
  const Buffer<std::pair<int32_t, int32_t>>& links() const { return links_; }

 private:
  static constexpr size_t kMany = 16;  // fewer are searched one by one; a pole may have hundreds

  int32_t add(int32_t wedge, bool of_u) {
    const int32_t found = row_of(wedge);
    if (found != kNone) return found;
    const auto row = static_cast<int32_t>(members_.size());
    members_.push_back({wedge, row, of_u});
    if (members_.size() >= kMany) index();
    return row;
  }

  void join(int32_t a, int32_t b) {
    if (a == b) return;
    for (Member& m : members_)
      if (m.group == std::max(a, b)) m.group = std::min(a, b);
  }

  void number_groups() {
    number_.resize(members_.size());
    for (size_t i = 0; i < members_.size(); ++i) {
      Member& m = members_[i];
      if (m.group == static_cast<int32_t>(i)) {
        number_[i] = static_cast<int32_t>(groups_.size());
        groups_.push_back({m.wedge, 0});
      }
      m.group = number_[m.group];
      groups_[m.group].of_v += !m.of_u;
    }
  }

  int32_t row_of(int32_t wedge) const {
    if (members_.size() < kMany) {
      for (size_t i = 0; i < members_.size(); ++i)
        if (members_[i].wedge == wedge) return static_cast<int32_t>(i);
      return kNone;
    }
    for (size_t at = slot(wedge);; at = (at + 1) & (table_.size() - 1)) {
      if (table_[at] == kNone) return kNone;
      if (members_[table_[at]].wedge == wedge) return table_[at];
    }
  }

  // Brings the last member into the hash table, or all of them when it was not in use or is half full.
  void index() {
    size_t from = members_.size() - 1;
    if (members_.size() == kMany || 2 * members_.size() > table_.size()) {
      size_t size = 4 * kMany;
      while (size < 4 * members_.size()) size *= 2;
      table_.resize(size);
      std::fill(table_.begin(), table_.end(), kNone);
      from = 0;
    }
    for (size_t i = from; i < members_.size(); ++i) {
      size_t at = slot(members_[i].wedge);
      while (table_[at] != kNone) at = (at + 1) & (table_.size() - 1);
      table_[at] = static_cast<int32_t>(i);
    }
  }
  size_t slot(int32_t wedge) const { return (static_cast<uint32_t>(wedge) * 0x9E3779B1u >> 7) & (table_.size() - 1); }

  Buffer<Member> members_;  // those of v first
  Buffer<Group> groups_;
  Buffer<std::pair<int32_t, int32_t>> links_;
  Buffer<uint8_t> joined_;
  Buffer<int32_t> number_, table_;  // rows of members_ by the hash of their wedge
};

}  // namespace lodpipe
