// Sparse symmetric systems whose unknowns sit at the corners of triangles: assembled by rows, solved by conjugate
// gradients. Sums are made in blocks of a fixed size, so that they do not depend on the number of threads.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "memory.h"
#include "parallel.h"
#include "quadric.h"

namespace lodpipe {

// The corners (3 · face + slot) that have each of `count` numbers.
struct Corners {
  std::vector<int32_t> start, list;
  Corners() = default;
  Corners(const int32_t* numbers, int faces, int count) : start(static_cast<size_t>(count) + 1, 0), list(3 * static_cast<size_t>(faces)) {
    const int64_t all = 3 * static_cast<int64_t>(faces);
    for (int64_t i = 0; i < all; ++i) ++start[numbers[i] + 1];
    for (int i = 0; i < count; ++i) start[i + 1] += start[i];
    std::vector<int32_t> next(start.begin(), start.end() - 1);
    for (int64_t i = 0; i < all; ++i) list[next[numbers[i]]++] = static_cast<int32_t>(i);
  }
  int size() const { return static_cast<int>(start.size()) - 1; }
};

constexpr int kPair[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};  // of two corners or axes, in a symmetric matrix

using Symmetric = std::array<float, 6>;  // xx xy xz yy yz zz
inline Vec3 operator*(const Symmetric& a, Vec3 v) {
  return {a[0] * v.x + a[1] * v.y + a[2] * v.z, a[1] * v.x + a[3] * v.y + a[4] * v.z, a[2] * v.x + a[4] * v.y + a[5] * v.z};
}
inline void add(Symmetric& to, const Symmetric& a) {
  for (int i = 0; i < 6; ++i) to[i] += a[i];
}
inline void add(float& to, float a) { to += a; }

// A matrix by rows: in each the unknown itself comes first. At hubs of very many faces a column may come twice.
template <class Block>
class Rows {
 public:
  // block(face, k, l) is the part of the face for its corners k and l; `numbers` are the unknowns at the corners.
  template <class Of>
  Rows(Pool& pool, int grain, const Corners& corners, const int32_t* numbers, const Of& block)
      : start_(corners.start), used_(corners.size()), column_(2 * corners.list.size() + corners.size()), block_(column_.size()) {
    pool.range(corners.size(), grain, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) {
        const size_t first = begins(i);
        size_t last = first + 1;
        column_[first] = i, block_[first] = Block{};
        for (int32_t j = corners.start[i]; j < corners.start[i + 1]; ++j) {
          const int32_t f = corners.list[j] / 3;
          const int k = corners.list[j] % 3;
          for (int l = 0; l < 3; ++l) {
            const int32_t to = numbers[3 * static_cast<size_t>(f) + l];
            size_t at = to == i || last - first < kSearched ? first : last - kSearched;
            while (at < last && column_[at] != to) ++at;
            if (at == last) column_[last] = to, block_[last++] = Block{};
            add(block_[at], block(f, k, l));
          }
        }
        used_[i] = static_cast<int32_t>(last - first);
      }
    });
  }
  const Block& diagonal(int row) const { return block_[begins(row)]; }
  template <class Each>
  void row(int i, const Each& each) const {
    const size_t first = begins(i);
    for (size_t at = first; at < first + used_[i]; ++at) each(block_[at], column_[at]);
  }

 private:
  static constexpr size_t kSearched = 32;
  size_t begins(int i) const { return 2 * static_cast<size_t>(start_[i]) + i; }  // a corner brings two others at most
  const std::vector<int32_t>& start_;
  std::vector<int32_t> used_;
  Large<int32_t> column_;
  Large<Block> block_;
};

// Sums over blocks of rows: body(row, sums) adds to `width` numbers.
template <class Body>
void blocked_sums(Pool& pool, int size, int grain, int width, std::vector<double>& sums, const Body& body) {
  const int pieces = (size + grain - 1) / grain;
  std::vector<double> parts(static_cast<size_t>(pieces) * width, 0.0);
  pool.range(size, grain, [&](int begin, int end) {
    double* own = parts.data() + static_cast<size_t>(begin / grain) * width;
    for (int i = begin; i < end; ++i) body(i, own);
  });
  sums.assign(width, 0.0);
  for (int piece = 0; piece < pieces; ++piece)
    for (int c = 0; c < width; ++c) sums[c] += parts[static_cast<size_t>(piece) * width + c];
}

struct Stop {
  int steps;      // at most
  double enough;  // squared residual, relative to the first
};

inline Symmetric inverted(const Symmetric& a) {
  const float cxx = a[3] * a[5] - a[4] * a[4], cxy = a[2] * a[4] - a[1] * a[5], cxz = a[1] * a[4] - a[2] * a[3];
  const float det = a[0] * cxx + a[1] * cxy + a[2] * cxz;
  const float trace = a[0] + a[3] + a[5];
  if (!(det > 1e-9f * trace * trace * trace)) {
    const float s = trace > 0 ? 3 / trace : 0;
    return {s, 0, 0, s, 0, s};
  }
  const float over = 1 / det;
  return {cxx * over, cxy * over, cxz * over, (a[0] * a[5] - a[2] * a[2]) * over, (a[1] * a[2] - a[0] * a[4]) * over,
          (a[0] * a[3] - a[1] * a[1]) * over};
}

// d with A d = r, as near as `stop` says; r is used up.
template <class Asked>
std::vector<Vec3> solve_points(Pool& pool, int grain, const Rows<Symmetric>& a, std::vector<Vec3>& r, Stop stop, const Asked& go_on) {
  const int size = static_cast<int>(r.size());
  std::vector<Symmetric> inverse(size);
  std::vector<Vec3> d(size), p(size), q(size);
  std::vector<double> rz, curve, next;
  blocked_sums(pool, size, grain, 1, rz, [&](int i, double* sum) {
    inverse[i] = inverted(a.diagonal(i));
    p[i] = inverse[i] * r[i];
    *sum += dot(r[i], p[i]);
  });
  const double enough = stop.enough * rz[0];
  for (int step = 0; step < stop.steps && rz[0] > enough && go_on(); ++step) {
    blocked_sums(pool, size, grain, 1, curve, [&](int i, double* sum) {
      Vec3 product;
      a.row(i, [&](const Symmetric& block, int32_t j) { product = product + block * p[j]; });
      q[i] = product;
      *sum += dot(p[i], product);
    });
    if (!(curve[0] > 0)) break;
    const auto alpha = static_cast<float>(rz[0] / curve[0]);
    blocked_sums(pool, size, grain, 1, next, [&](int i, double* sum) {
      d[i] = d[i] + p[i] * alpha, r[i] = r[i] - q[i] * alpha;
      *sum += dot(r[i], inverse[i] * r[i]);
    });
    const auto beta = static_cast<float>(next[0] / rz[0]);
    pool.range(size, grain, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) p[i] = inverse[i] * r[i] + p[i] * beta;
    });
    rz = next;
  }
  return d;
}

// The same for tables of `lanes` · 4 columns that have one matrix, each column solved for itself.
template <class Asked>
Large<Lanes> solve_columns(Pool& pool, int grain, const Rows<float>& a, Large<Lanes>& r, int lanes, Stop stop, const Asked& go_on) {
  const int size = lanes ? static_cast<int>(r.size() / lanes) : 0, width = 4 * lanes;
  Large<Lanes> x(r.size()), p(r.size()), q(r.size());
  std::vector<float> over(size);
  std::vector<double> rz, start, curve, next;
  std::vector<Lanes> alpha(lanes), beta(lanes);
  const auto add_product = [&](double* sum, Lanes u, Lanes v) {
    for (int c = 0; c < 4; ++c) sum[c] += static_cast<double>(u[c]) * v[c];
  };
  blocked_sums(pool, size, grain, width, rz, [&](int i, double* sum) {
    over[i] = a.diagonal(i) > 0 ? 1 / a.diagonal(i) : 0;
    for (int l = 0; l < lanes; ++l) {
      const size_t at = static_cast<size_t>(i) * lanes + l;
      x[at] = Lanes{}, p[at] = r[at] * over[i];
      add_product(sum + 4 * l, r[at], p[at]);
    }
  });
  start = rz;
  for (int step = 0; step < stop.steps && go_on(); ++step) {
    blocked_sums(pool, size, grain, width, curve, [&](int i, double* sum) {
      Lanes* to = &q[static_cast<size_t>(i) * lanes];
      std::fill(to, to + lanes, Lanes{});
      a.row(i, [&](float m, int32_t j) {
        for (int l = 0; l < lanes; ++l) to[l] += m * p[static_cast<size_t>(j) * lanes + l];
      });
      for (int l = 0; l < lanes; ++l) add_product(sum + 4 * l, p[static_cast<size_t>(i) * lanes + l], to[l]);
    });
    bool any = false;
    for (int c = 0; c < width; ++c) {
      const bool goes_on = rz[c] > stop.enough * start[c] && curve[c] > 0;
      alpha[c / 4][c % 4] = goes_on ? static_cast<float>(rz[c] / curve[c]) : 0;
      any |= goes_on;
    }
    if (!any) break;
    blocked_sums(pool, size, grain, width, next, [&](int i, double* sum) {
      for (int l = 0; l < lanes; ++l) {
        const size_t at = static_cast<size_t>(i) * lanes + l;
        x[at] += alpha[l] * p[at], r[at] -= alpha[l] * q[at];
        add_product(sum + 4 * l, r[at], r[at] * over[i]);
      }
    });
    for (int c = 0; c < width; ++c) beta[c / 4][c % 4] = rz[c] > 0 ? static_cast<float>(next[c] / rz[c]) : 0;
    pool.range(size, grain, [&](int begin, int end) {
      for (int i = begin; i < end; ++i)
        for (int l = 0; l < lanes; ++l) {
          const size_t at = static_cast<size_t>(i) * lanes + l;
          p[at] = r[at] * over[i] + beta[l] * p[at];
        }
    });
    rz = next;
  }
  return x;
}

}  // namespace lodpipe
