// Attributes that do not steer: the values of a level, taken from the input when the level is emitted.
//
// What fits best all the faces that came to a wedge, Σ w (g·x + d) / Σ w (Hoppe 1999), is a sum over the input's faces,
// whatever the order of the collapses: nothing needs to be carried through them.
#pragma once
#include <algorithm>
#include <vector>

#include "chart.h"
#include "mesh_state.h"
#include "parallel.h"

namespace lodpipe {

// A wedge of the level.
struct CarriedWedge {
  Vec3 at;         // its vertex, in the unit box
  int32_t source;  // wedge of the input that stands for it
  bool moved;      // its values are new
  bool in_chart;   // and its UVs stay within their chart: it lies at a seam
};

class Carry {
 public:
  // `wedge_to`: for each wedge of the input the level's, or kNone.
  Carry(const Input& in, const State& s, const std::vector<CarriedWedge>& wedges, const std::vector<int32_t>& wedge_to)
      : in_(in), s_(s), wedges_(wedges), wedge_to_(wedge_to), columns_(static_cast<size_t>(in.columns)) {}

  // Writes the rows of `values` (wedges × columns) whose wedges moved. Each row is a sum in the order of the faces, and
  // so the same for any number of threads.
  void run(Pool& pool, float* values) {
    const int pieces = pool.threads();
    const auto count = static_cast<int64_t>(wedges_.size());
    weights_.assign(wedges_.size(), 0.0f);
    bool charts = false;
    for (int64_t i = 0; i < count; ++i) {
      if (wedges_[i].moved) std::fill_n(values + i * in_.columns, columns_, 0.0f);
      charts |= wedges_[i].in_chart;
    }
    if (charts) places_.resize(wedges_.size());
    pool.run(pieces, [&](int piece) {
      const auto begin = static_cast<int32_t>(count * piece / pieces);
      const auto end = static_cast<int32_t>(count * (piece + 1) / pieces);
      sum(begin, end, values);
      divide(begin, end, values);
      if (charts) keep_in_charts(begin, end, values);
    });
  }

 private:
  const float* given(int32_t wedge) const { return in_.values + static_cast<size_t>(wedge) * columns_; }
  Vec3 place(int32_t vertex) const {
    const double* p = in_.positions + 3 * static_cast<int64_t>(vertex);
    return {static_cast<float>((p[0] - s_.center[0]) * s_.scale), static_cast<float>((p[1] - s_.center[1]) * s_.scale),
            static_cast<float>((p[2] - s_.center[2]) * s_.scale)};
  }

  // Calls body(face, to) for the faces that have a corner among the wedges [begin, end) that `want`; to[k] < 0: not one.
  template <class Want, class Body>
  void each_face(int32_t begin, int32_t end, const Want& want, const Body& body) const {
    const int32_t* const wedge_to = wedge_to_.data();
    const CarriedWedge* const wedges = wedges_.data();
    for (int64_t f = 0; f < in_.face_count; ++f) {
      int32_t to[3];
      for (int k = 0; k < 3; ++k) {
        to[k] = wedge_to[in_.wedges[3 * f + k]];
        if (to[k] < begin || to[k] >= end || !want(wedges[to[k]])) to[k] = kNone;
      }
      if ((to[0] & to[1] & to[2]) < 0) continue;
      const int32_t* v = in_.faces + 3 * f;
      if (v[0] != v[1] && v[1] != v[2] && v[0] != v[2]) body(f, to);
    }
  }

  // The face's linear function, value₀ + g·x, at each wedge's place. Values count from those of the wedge's source, so
  // that what is the same everywhere stays as it is.
  void sum(int32_t begin, int32_t end, float* values) {
    each_face(begin, end, [](const CarriedWedge& w) { return w.moved; }, [&](int64_t f, int32_t* to) {
      const int32_t *v = in_.faces + 3 * f, *w = in_.wedges + 3 * f;
      const Vec3 p = place(v[0]), e1 = place(v[1]) - p, e2 = place(v[2]) - p, across = cross(e1, e2);
      const float twice = length(across);
      if (!(twice > 0)) return;
      const Vec3 n = across * (1 / twice), dual1 = cross(e2, n), dual2 = cross(n, e1);
      const float *v0 = given(w[0]), *v1 = given(w[1]), *v2 = given(w[2]);
      float shares[3] = {1, 1, 1};  // of the area; several corners may have come to the same wedge
      for (int k = 0; in_.importance && k < 3; ++k) shares[k] = in_.importance[v[k]];
      if (to[2] == to[1]) to[2] = kNone, shares[1] += shares[2];
      if (to[1] == to[0]) to[1] = kNone, shares[0] += shares[1];
      if (to[2] == to[0]) to[2] = kNone, shares[0] += shares[2];
      for (int k = 0; k < 3; ++k) {
        if (to[k] < 0) continue;
        const float share = shares[k] * (1.0f / 6);
        const Vec3 d = wedges_[to[k]].at - p;
        const float weight = share * twice, along1 = share * dot(dual1, d), along2 = share * dot(dual2, d);
        const float* from = given(wedges_[to[k]].source);
        float* row = values + static_cast<size_t>(to[k]) * columns_;
        size_t c = 0;
        for (; c + 4 <= columns_; c += 4)
          add<Lanes>(row + c, weight, along1, along2, from + c, v0 + c, v1 + c, v2 + c);
        for (; c < columns_; ++c) add<float>(row + c, weight, along1, along2, from + c, v0 + c, v1 + c, v2 + c);
        weights_[to[k]] += weight;
      }
    });
  }

  template <class T>  // one column, or four
  static void add(float* row, float weight, float along1, float along2, const float* from, const float* at0,
                  const float* at1, const float* at2) {
    T sum, base, v0, v1, v2;
    std::memcpy(&sum, row, sizeof(T)), std::memcpy(&base, from, sizeof(T));
    std::memcpy(&v0, at0, sizeof(T)), std::memcpy(&v1, at1, sizeof(T)), std::memcpy(&v2, at2, sizeof(T));
    sum += weight * (v0 - base) + along1 * (v1 - v0) + along2 * (v2 - v0);
    std::memcpy(row, &sum, sizeof(T));
  }

  void divide(int32_t begin, int32_t end, float* values) const {
    for (int32_t i = begin; i < end; ++i) {
      if (!wedges_[i].moved) continue;
      const float* from = given(wedges_[i].source);
      float* row = values + static_cast<size_t>(i) * columns_;
      for (size_t c = 0; c < columns_; ++c) row[c] = from[c] + (weights_[i] > 0 ? row[c] / weights_[i] : 0.0f);
    }
  }

  void keep_in_charts(int32_t begin, int32_t end, float* values) {
    const auto uv = [&](const float* row) { return UvPoint{row[s_.chart_column], row[s_.chart_column + 1]}; };
    const auto row = [&](int32_t i) { return values + static_cast<size_t>(i) * columns_; };
    for (int32_t i = begin; i < end; ++i) places_[i] = ChartPlace(uv(row(i)));
    each_face(begin, end, [](const CarriedWedge& w) { return w.in_chart; }, [&](int64_t f, const int32_t* to) {
      const int32_t* w = in_.wedges + 3 * f;
      const UvPoint corner[3] = {uv(given(w[0])), uv(given(w[1])), uv(given(w[2]))};
      for (int k = 0; k < 3; ++k)
        if (to[k] != kNone) places_[to[k]].look(corner);
    });
    for (int32_t i = begin; i < end; ++i) {
      if (!wedges_[i].in_chart) continue;
      const UvPoint kept = places_[i].kept(kGutter);
      row(i)[s_.chart_column] = kept.x, row(i)[s_.chart_column + 1] = kept.y;
    }
  }

  const Input& in_;
  const State& s_;
  const std::vector<CarriedWedge>& wedges_;
  const std::vector<int32_t>& wedge_to_;
  const size_t columns_;
  std::vector<float> weights_;
  std::vector<ChartPlace> places_;
};

}  // namespace lodpipe
