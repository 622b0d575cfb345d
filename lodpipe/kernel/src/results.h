// What comes out: levels, and the record of collapses.
#pragma once
#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "carry.h"
#include "mesh_state.h"

namespace lodpipe {

// Collapses of one block in one round.
struct Notes {
  Record record;               // of the state's vertices and wedges
  std::vector<int32_t> ranks;  // of its rows in the round's order
  void clear() { record = {}, ranks.clear(); }
};

class Results {
 public:
  Results(const Input& in, State& s) : in_(in), s_(s) {}

  // `links`: pairs of wedges, gone and kept; the same twice where only the values changed.
  void note(int32_t rank, int32_t v, int32_t u, int removed, const Buffer<std::pair<int32_t, int32_t>>& links,
            Notes& notes) const {
    Record& r = notes.record;
    const auto row = static_cast<int32_t>(r.removed.size());
    notes.ranks.push_back(rank);
    r.removed.push_back(u);
    r.kept.push_back(v);
    r.triangles.push_back(removed);
    r.error.push_back(s_.vertices[v].error);
    for (const double c : world(v)) r.positions.push_back(c);
    for (const auto& [from, to] : links) {
      r.wedge_event.push_back(row);
      r.wedge_from.push_back(from);
      r.wedge_to.push_back(to);
      const size_t at = r.wedge_values.size();
      r.wedge_values.resize(at + s_.columns);
      values_of(to, r.wedge_values.data() + at);
    }
  }

  // Rows of blocks that do not overlap, in the order in which one thread would have picked them.
  void append(const std::vector<const Notes*>& blocks) {
    struct Row {
      int32_t rank, block, row;
    };
    std::vector<Row> rows;
    for (size_t b = 0; b < blocks.size(); ++b)
      for (size_t i = 0; i < blocks[b]->ranks.size(); ++i)
        rows.push_back({blocks[b]->ranks[i], static_cast<int32_t>(b), static_cast<int32_t>(i)});
    std::sort(rows.begin(), rows.end(), [](const Row& a, const Row& b) {
      return a.rank != b.rank ? a.rank < b.rank : a.block != b.block ? a.block < b.block : a.row < b.row;
    });
    std::vector<std::vector<int32_t>> first(blocks.size());  // wedge event of each row
    for (size_t b = 0; b < blocks.size(); ++b) {
      first[b].assign(blocks[b]->ranks.size() + 1, 0);
      for (const int32_t e : blocks[b]->record.wedge_event) ++first[b][static_cast<size_t>(e) + 1];
      for (size_t i = 0; i + 1 < first[b].size(); ++i) first[b][i + 1] += first[b][i];
    }
    Record& out = result.record;
    for (const Row& at : rows) {
      const Record& r = blocks[at.block]->record;
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

  void emit(int64_t target, Stop stop, bool relaxed, bool follow, Pool& pool) {
    Level level;
    level.target = target;
    level.stop = stop;
    level.relaxed = relaxed;
    std::vector<int32_t> number(s_.vertices.size(), kNone), wedge_number(s_.wedge_source.size(), kNone);
    float error = 0;
    const size_t count = static_cast<size_t>(s_.triangles);
    level.faces.resize(3 * count), level.wedges.resize(3 * count), level.face_source.resize(count);
    int32_t *to_face = level.faces.data(), *to_wedge = level.wedges.data(), *to_source = level.face_source.data();
    level.vertex_source.reserve(s_.live.size()), level.positions.reserve(3 * s_.live.size());
    level.wedge_source.reserve(s_.live.size()), level.values.reserve(s_.live.size() * s_.columns);
    if (s_.late) carried_.reserve(s_.live.size());
    for (size_t i = 0; i < s_.wedges.size(); ++i) {
      const Face& f = s_.faces[i];
      const Wedges& wedges = s_.wedges[i];
      if (f.dead()) continue;
      *to_source++ = f.source;
      for (int k = 0; k < 3; ++k) {
        int32_t& n = number[f.v[k]];
        if (n == kNone) {
          n = static_cast<int32_t>(level.vertex_source.size());
          const Vertex& a = s_.vertices[f.v[k]];
          error = std::max(error, a.error);
          level.vertex_source.push_back(s_.flags[f.v[k]] & kMoved ? kNone : s_.vertex_source[f.v[k]]);
          for (const double c : world(f.v[k])) level.positions.push_back(c);
        }
        *to_face++ = n;
        int32_t& w = wedge_number[wedges.w[k]];
        if (w == kNone) {
          w = static_cast<int32_t>(level.wedge_source.size());
          emit_wedge(wedges.w[k], f.v[k], level);
        }
        *to_wedge++ = w;
      }
    }
    level.error = error / s_.scale;
    std::vector<int32_t> wedge_to;
    if (follow || s_.late) wedge_to = followed(s_.wedge_into, s_.wedge_source, wedge_number, in_.wedge_count);
    if (s_.late) {
      Carry(in_, s_, carried_, wedge_to).run(pool, level.values.data());
      carried_.clear();
    }
    if (follow) {
      level.vertex_to = followed(s_.vertex_into, s_.vertex_source, number, in_.vertex_count);
      level.wedge_to = std::move(wedge_to);
    }
    result.levels.push_back(std::move(level));
  }

  Result result;

 private:
  std::array<double, 3> world(int32_t v) const {
    const Vertex& a = s_.vertices[v];
    if (!(s_.flags[v] & kMoved)) {
      const double* p = in_.positions + 3 * static_cast<int64_t>(s_.vertex_source[v]);
      return {p[0], p[1], p[2]};
    }
    return {s_.center[0] + a.p.x / s_.scale, s_.center[1] + a.p.y / s_.scale, s_.center[2] + a.p.z / s_.scale};
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

  void emit_wedge(int32_t w, int32_t v, Level& level) {
    const bool moved = s_.columns && (s_.late ? s_.flags[v] & kMoved : s_.wedge_moved[w]);
    level.wedge_source.push_back(moved ? kNone : s_.wedge_source[w]);
    const size_t row = level.values.size();
    level.values.resize(row + s_.columns);
    if (s_.late) {
      const bool at_seam = s_.flags[v] & kSeveralWedges;
      carried_.push_back({s_.vertices[v].p, s_.wedge_source[w], moved, moved && at_seam && s_.chart_column >= 0});
    }
    if (!s_.late || !moved) values_of(w, level.values.data() + row);
  }

  // A wedge's values in the input's order and scale; to the last bit the input's while it was not moved.
  void values_of(int32_t w, float* out) const {
    const bool moved = s_.columns && !s_.late && s_.wedge_moved[w];
    for (int k = 0; k < s_.columns; ++k)
      out[s_.column_source[k]] =
          moved ? s_.values(w)[k] / s_.column_scale[k]
                : in_.values[static_cast<size_t>(s_.wedge_source[w]) * s_.columns + s_.column_source[k]];
  }

  std::vector<CarriedWedge> carried_;  // of the level being emitted
  const Input& in_;
  State& s_;  // changed only in that its paths get shorter
};

}  // namespace lodpipe
