#include "silhouette.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "parallel.h"

namespace lodpipe {
namespace {

// Sets bits [begin, end) of a row.
void fill(uint64_t* row, int begin, int end) {
  for (int word = begin / 64; word * 64 < end; ++word) {
    const int low = std::max(begin - word * 64, 0), high = std::min(end - word * 64, 64);
    row[word] |= (high == 64 ? ~0ull : (1ull << high) - 1) & (~0ull << low);
  }
}

void draw(const double corner[3][2], int size, int words, uint64_t* rows) {
  double low = corner[0][1], high = low;
  for (int k = 1; k < 3; ++k) low = std::min(low, corner[k][1]), high = std::max(high, corner[k][1]);
  const int first = static_cast<int>(std::clamp(std::ceil(low - 0.5), 0.0, double(size)));
  const int last = static_cast<int>(std::clamp(std::floor(high - 0.5) + 1, 0.0, double(size)));
  for (int y = first; y < last; ++y) {
    double left = INFINITY, right = -INFINITY;
    for (int k = 0; k < 3; ++k) {  // where the row's middle crosses the edges
      const double *a = corner[k], *b = corner[(k + 1) % 3];
      const double da = a[1] - (y + 0.5), db = b[1] - (y + 0.5);
      if ((da < 0) == (db < 0) && da != 0 && db != 0) continue;
      const double x = da == db ? a[0] : a[0] + (b[0] - a[0]) * (da / (da - db));
      left = std::min(left, x), right = std::max(right, x);
      if (da == db) left = std::min(left, b[0]), right = std::max(right, b[0]);
    }
    const int begin = static_cast<int>(std::clamp(std::ceil(left - 0.5), 0.0, double(size)));
    const int end = static_cast<int>(std::clamp(std::floor(right - 0.5) + 1, 0.0, double(size)));
    if (begin < end) fill(rows + y * words, begin, end);
  }
}

// Draws a triangle of `points` into one view's rows.
void draw_face(const double* const place[3], const SilhouetteViews& views, int view, uint64_t* rows) {
  const double* axes = views.axes + 6 * view;
  double corner[3][2];
  for (int k = 0; k < 3; ++k)
    for (int a = 0; a < 2; ++a) {
      const double *axis = axes + 3 * a, *p = place[k];
      corner[k][a] = (p[0] * axis[0] + p[1] * axis[1] + p[2] * axis[2] + 1) / 2 * views.size;
    }
  draw(corner, views.size, views.words(), rows);
}

double share(const uint64_t* rows, const uint64_t* goal, size_t words) {
  int64_t both = 0, either = 0;
  for (size_t i = 0; i < words; ++i) both += std::popcount(rows[i] & goal[i]), either += std::popcount(rows[i] | goal[i]);
  return either ? double(both) / double(either) : 1.0;
}

}  // namespace

std::vector<uint64_t> silhouettes(const double* points, const int32_t* faces, int face_count,
                                  const SilhouetteViews& views) {
  const size_t one = size_t(views.size) * views.words();
  std::vector<uint64_t> bits(one * views.count, 0);
  for (int f = 0; f < face_count; ++f) {
    const double* place[3];
    for (int k = 0; k < 3; ++k) place[k] = points + 3 * faces[3 * f + k];
    for (int view = 0; view < views.count; ++view) draw_face(place, views, view, bits.data() + one * view);
  }
  return bits;
}

double silhouette_overlap(const double* points, const int32_t* faces, int face_count, const SilhouetteViews& views,
                          const uint64_t* wanted) {
  const size_t one = size_t(views.size) * views.words();
  const std::vector<uint64_t> bits = silhouettes(points, faces, face_count, views);
  double sum = 0;
  for (int view = 0; view < views.count; ++view) sum += share(bits.data() + one * view, wanted + one * view, one);
  return views.count ? sum / views.count : 0.0;
}

std::vector<double> silhouette_moves(const double* points, int vertex_count, const int32_t* faces, int face_count,
                                     const int32_t* vertex, const double* places, int moves,
                                     const SilhouetteViews& views, const uint64_t* wanted, int threads) {
  const size_t one = size_t(views.size) * views.words(), all = one * views.count;
  std::vector<std::vector<int>> moves_of(vertex_count), faces_of(vertex_count);
  std::vector<int> moved;
  for (int m = 0; m < moves; ++m) {
    if (moves_of[vertex[m]].empty()) moved.push_back(vertex[m]);
    moves_of[vertex[m]].push_back(m);
  }
  std::vector<uint64_t> drawn(all * face_count);  // each face by itself
  for (int f = 0; f < face_count; ++f) {
    const std::vector<uint64_t> bits = silhouettes(points, faces + 3 * f, 1, views);
    std::copy(bits.begin(), bits.end(), drawn.begin() + all * f);
    for (int k = 0; k < 3; ++k) faces_of[faces[3 * f + k]].push_back(f);
  }
  std::vector<double> overlaps(moves, 0.0);
  Pool pool(std::max(std::min(threads, static_cast<int>(moved.size())), 1));
  pool.run(static_cast<int>(moved.size()), [&](int i) {
    const int v = moved[i];
    std::vector<uint64_t> rest(all, 0), rows(one);
    for (int f = 0; f < face_count; ++f) {
      const int32_t* face = faces + 3 * f;
      if (face[0] == v || face[1] == v || face[2] == v) continue;
      for (size_t w = 0; w < all; ++w) rest[w] |= drawn[all * f + w];
    }
    for (const int m : moves_of[v]) {
      double sum = 0;
      for (int view = 0; view < views.count; ++view) {
        std::copy_n(rest.begin() + one * view, one, rows.begin());
        for (const int f : faces_of[v]) {
          const double* place[3];
          for (int k = 0; k < 3; ++k) place[k] = faces[3 * f + k] == v ? places + 3 * m : points + 3 * faces[3 * f + k];
          draw_face(place, views, view, rows.data());
        }
        sum += share(rows.data(), wanted + one * view, one);
      }
      overlaps[m] = views.count ? sum / views.count : 0.0;
    }
  });
  return overlaps;
}

}  // namespace lodpipe
