// Packing of charts: masks of cells, placed one after the other where they first fit, the largest chart first.
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "uv.h"

namespace lodpipe {
namespace {

using Word = uint64_t;

// Rows of bits, one for each cell.
class Bits {
 public:
  Bits(int width, int height) : width_(width), height_(height), words_((width + 63) / 64 + 1) {
    bits_.assign(static_cast<size_t>(words_) * height, 0);
  }
  int width() const { return width_; }
  int height() const { return height_; }
  int words() const { return words_ - 1; }
  const Word* row(int y) const { return bits_.data() + static_cast<size_t>(y) * words_; }
  Word* row(int y) { return bits_.data() + static_cast<size_t>(y) * words_; }
  void set(int y, int from, int to) {  // [from, to)
    for (int x = std::max(from, 0); x < std::min(to, width_); ++x) row(y)[x / 64] |= Word{1} << (x % 64);
  }
  // 64 bits from column x on.
  Word at(int y, int x) const {
    const Word* words = row(y) + x / 64;
    const int shift = x % 64;
    return shift ? words[0] >> shift | words[1] << (64 - shift) : words[0];
  }

 private:
  int width_, height_, words_;
  std::vector<Word> bits_;
};

bool collides(const Bits& page, const Bits& mask, int x, int y) {
  for (int r = 0; r < mask.height(); ++r)
    for (int w = 0; w < mask.words(); ++w)
      if (const Word bits = mask.row(r)[w]; bits && (bits & page.at(y + r, std::min(x + 64 * w, page.width())))) return true;
  return false;
}

void stamp(Bits& page, const Bits& mask, int x, int y) {
  for (int r = 0; r < mask.height(); ++r)
    for (int w = 0; w < mask.words(); ++w) {
      const Word bits = mask.row(r)[w];
      if (!bits) continue;
      const int column = x + 64 * w, shift = column % 64;
      Word* words = page.row(y + r) + column / 64;
      words[0] |= bits << shift;
      if (shift && bits >> (64 - shift)) words[1] |= bits >> (64 - shift);
    }
}

struct Chart {
  std::vector<int> faces;
  double width = 0, height = 0;
};

struct Turned {
  double x, y;
};
Turned turned(double x, double y, const Chart& c, int quarters) {
  switch (quarters) {
    case 1: return {y, c.width - x};
    case 2: return {c.width - x, c.height - y};
    case 3: return {c.height - y, x};
    default: return {x, y};
  }
}

// The cells that a chart touches, grown by half the padding; its box begins half the padding from the mask's corner.
Bits mask_of(const UvFaces& in, const Chart& chart, int quarters, double scale, double cell, double margin) {
  const bool across = quarters % 2;
  const double w = (across ? chart.height : chart.width) * scale, h = (across ? chart.width : chart.height) * scale;
  const auto cells = [&](double size) { return std::max(1, static_cast<int>(std::ceil((size + 2 * margin) / cell - 1e-9))); };
  Bits mask(cells(w), cells(h));
  for (int f : chart.faces) {
    std::array<Turned, 3> t;
    for (int k = 0; k < 3; ++k) {
      const double* p = in.uv + 6 * static_cast<size_t>(f) + 2 * k;
      t[k] = turned(p[0], p[1], chart, quarters);
      t[k] = {t[k].x * scale + margin, t[k].y * scale + margin};
    }
    const double low = std::min({t[0].y, t[1].y, t[2].y}) - margin, high = std::max({t[0].y, t[1].y, t[2].y}) + margin;
    const int first = std::clamp(static_cast<int>(std::floor(low / cell + 1e-9)), 0, mask.height() - 1);
    const int last = std::clamp(static_cast<int>(std::ceil(high / cell - 1e-9)) - 1, first, mask.height() - 1);
    for (int row = first; row <= last; ++row) {
      // the part of the triangle within the row, grown by the margin
      const double from = row * cell - margin, to = (row + 1) * cell + margin;
      double left = 1e300, right = -1e300;
      for (int k = 0; k < 3; ++k) {
        const Turned p = t[k], q = t[(k + 1) % 3];
        if (p.y >= from && p.y <= to) left = std::min(left, p.x), right = std::max(right, p.x);
        for (const double y : {from, to})
          if ((p.y < y) != (q.y < y)) {
            const double x = p.x + (q.x - p.x) * ((y - p.y) / (q.y - p.y));
            left = std::min(left, x);
            right = std::max(right, x);
          }
      }
      if (left > right) continue;
      mask.set(row, static_cast<int>(std::floor((left - margin) / cell + 1e-9)),
               static_cast<int>(std::ceil((right + margin) / cell - 1e-9)));
    }
  }
  return mask;
}

// The lowest row, and in it the first column, where the mask fits; y = −1: nowhere below `limit`.
std::pair<int, int> first_fit(const Bits& page, const Bits& mask, int limit) {
  const int last = std::min(page.height() - mask.height(), limit - mask.height());
  int lead = 0;  // the first column of the mask's first row that is taken
  while (lead < mask.width() && !(mask.row(0)[lead / 64] >> (lead % 64) & 1)) ++lead;
  for (int y = 0; y <= last; ++y)
    for (int x = 0; x + mask.width() <= page.width(); ++x) {
      if (lead < mask.width()) {
        const Word taken = page.at(y, x + lead);  // skip to where the first row's first cell is free
        if (taken & 1) {
          x += taken == ~Word{0} ? 63 : __builtin_ctzll(~taken) - 1;
          continue;
        }
      }
      if (!collides(page, mask, x, y)) return {x, y};
    }
  return {0, -1};
}

bool place(const UvFaces& in, const std::vector<Chart>& charts, const std::vector<int>& order, int width, int height,
           double padding, int cells, double scale, UvPacking& out) {
  const double cell = std::max(1.0, double(std::max(width, height)) / cells), margin = padding / 2;
  Bits page(static_cast<int>(width / cell + 1e-9), static_cast<int>(height / cell + 1e-9));
  const int turns = charts.size() > 500 ? 2 : 4;
  for (int c : order) {
    int best_x = 0, best_y = -1, best_turn = 0, best_top = page.height() + 1;
    Bits best(1, 1);
    for (int turn = 0; turn < turns; ++turn) {
      Bits mask = mask_of(in, charts[c], turn, scale, cell, margin);
      if (mask.width() > page.width() || mask.height() > page.height()) continue;
      const auto [x, y] = first_fit(page, mask, best_top - 1);
      if (y < 0) continue;
      best_x = x, best_y = y, best_turn = turn, best_top = y + mask.height();
      best = std::move(mask);
    }
    if (best_y < 0) return false;
    stamp(page, best, best_x, best_y);
    out.corner[2 * c] = best_x * cell + margin;
    out.corner[2 * c + 1] = best_y * cell + margin;
    out.turn[c] = best_turn;
  }
  out.scale = scale;
  return true;
}

}  // namespace

UvPacking uv_pack(const UvFaces& in, int count, int width, int height, double padding, int cells, double largest) {
  std::vector<Chart> charts(count);
  double area = 0;
  for (int f = 0; f < in.count; ++f) {
    Chart& chart = charts[in.chart[f]];
    chart.faces.push_back(f);
    const double* p = in.uv + 6 * static_cast<size_t>(f);
    chart.width = std::max({chart.width, p[0], p[2], p[4]});
    chart.height = std::max({chart.height, p[1], p[3], p[5]});
    area += std::abs((p[2] - p[0]) * (p[5] - p[1]) - (p[3] - p[1]) * (p[4] - p[0])) / 2;
  }
  std::vector<int> order(count);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return std::max(charts[a].width, charts[a].height) > std::max(charts[b].width, charts[b].height);
  });
  UvPacking best, trial;
  best.corner.assign(2 * static_cast<size_t>(count), 0.0);
  best.turn.assign(count, 0);
  trial = best;
  double fails = std::min(largest, area > 0 ? std::sqrt(double(width) * height / area) : largest);
  double scale = std::min(largest, fails);
  // down to the first scale that fits, then halve the interval above it
  for (int step = 0; step < 60 && !best.scale; ++step) {
    if (place(in, charts, order, width, height, padding, cells, scale, trial)) {
      best = trial;
    } else {
      fails = scale;
      scale *= step < 8 ? 0.93 : 0.8;
    }
  }
  for (int step = 0; step < 4 && best.scale && best.scale < fails; ++step) {
    const double middle = (best.scale + fails) / 2;
    if (place(in, charts, order, width, height, padding, cells, middle, trial))
      best = trial;
    else
      fails = middle;
  }
  return best;
}

}  // namespace lodpipe
