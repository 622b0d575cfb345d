#include "pictures.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "srgb.h"

namespace lodpipe {

namespace {

constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;  // of structural similarity
constexpr int kMargin = 16;                                // around what is shown: beyond it lies ground in both

using Plane = std::vector<float>;

// For each of `size` new pixels the first and the last of `from` old ones that it is the mean of.
std::vector<std::pair<int, int>> areas(int from, int size) {
  const double scale = static_cast<double>(from) / size, wide = std::max(scale, 1.0);
  std::vector<std::pair<int, int>> found;
  for (int i = 0; i < size; ++i) {
    const double centre = (i + 0.5) * scale;
    int first = std::max(static_cast<int>(centre - wide / 2 + 0.5), 0);
    int last = std::min(static_cast<int>(centre + wide / 2 + 0.5), from) - 1;
    const auto inside = [&](int x) {
      const double off = (x - centre + 0.5) / wide;
      return off > -0.5 && off <= 0.5;
    };
    while (first < last && !inside(first)) ++first;
    while (last > first && !inside(last)) --last;
    found.emplace_back(first, last);
  }
  return found;
}

// Of a picture (2h, 2h, 4), the means of each 2 × 2 pixels at every place: row `y` of (2h − 1, 2h − 1, 4), columns
// [left, right), on a ground and not encoded: three planes side by side a pixel.
void phase_row(const float* fine, int size, int y, int left, int right, const Ground& ground, float* out) {
  const float* upper = fine + static_cast<size_t>(y) * size * 4;
  const float* lower = upper + static_cast<size_t>(size) * 4;
  for (int x = left; x < right; ++x) {
    float mean[4];
    for (int k = 0; k < 4; ++k)
      mean[k] = ((upper[4 * x + k] + lower[4 * x + k]) * 0.5f + (upper[4 * x + 4 + k] + lower[4 * x + 4 + k]) * 0.5f) * 0.5f;
    const float rest = 1 - std::min(mean[3], 1.0f);
    for (int k = 0; k < 3; ++k) out[3 * (x - left) + k] = mean[k] + rest * ground.colour[k];
  }
}

// Rows of phases of a picture, the least and the greatest within two rows of every second one, then within two columns.
class Extremes {
 public:
  Extremes(const float* fine, int size, int top, int bottom, int left, int right, const Ground& ground)
      : rows_(bottom - top), wide_(right - left), phases_(static_cast<size_t>(rows_) * wide_ * 3) {
    for (int y = top; y < bottom; ++y) phase_row(fine, size, y, left, right, ground, row(y - top));
    low_.resize(static_cast<size_t>(wide_) * 3 + 2 * kBorder), high_.resize(low_.size());
  }

  // The pixel's own value is at 3 · column of row(2 · line).
  float* row(int y) { return phases_.data() + static_cast<size_t>(y) * wide_ * 3; }
  int lines() const { return (rows_ + 1) / 2; }
  int columns() const { return (wide_ + 1) / 2; }

  // The least and the greatest within two rows of a line and two columns of each of its phases: a pixel's are where its
  // own value is, at 6 · x.
  void around(int line, Plane& least, Plane& greatest) {
    const int middle = 2 * line, first = std::max(middle - 2, 0), last = std::min(middle + 2, rows_ - 1);
    const size_t count = static_cast<size_t>(wide_) * 3;
    for (Plane* side : {&low_, &high_}) std::copy_n(row(first), count, side->begin() + kBorder);
    float *low = low_.data() + kBorder, *high = high_.data() + kBorder;
    for (int y = first + 1; y <= last; ++y) {
      const float* from = row(y);
      for (size_t i = 0; i < count; ++i) {
        low[i] = std::min(low[i], from[i]);
        high[i] = std::max(high[i], from[i]);
      }
    }
    for (int k = 0; k < kBorder; ++k) {  // beyond a border lies the border
      low_[k] = low[k % 3], high_[k] = high[k % 3];
      low[count + k] = low[count - 3 + k % 3], high[count + k] = high[count - 3 + k % 3];
    }
    least.resize(count), greatest.resize(count);
    for (size_t i = 0; i < count; ++i) {
      const float *p = low_.data() + i, *q = high_.data() + i;
      least[i] = std::min(std::min(std::min(p[0], p[3]), std::min(p[6], p[9])), p[12]);
      greatest[i] = std::max(std::max(std::max(q[0], q[3]), std::max(q[6], q[9])), q[12]);
    }
  }

 private:
  static constexpr int kBorder = 6;  // values of two phases

  int rows_, wide_;
  Plane phases_, low_, high_;
};

// Adds where a pixel of `picture` lies outside of what `other` has within a pixel. Encoding keeps the order of values, so
// that only those outside have to be encoded to learn by how much.
void outside(Extremes& picture, Extremes& other, int line, const Ground& ground, float noticed, std::vector<uint8_t>& mask,
             Plane& least, Plane& greatest) {
  const Srgb& curve = Srgb::curve();
  const auto seen = [&](float value) {
    return ground.linear ? curve.encoded(value) : std::clamp(value, 0.0f, 1.0f);
  };
  other.around(line, least, greatest);
  const float* pixels = picture.row(2 * line);
  for (int x = 0; x < picture.columns(); ++x)
    for (int k = 0; k < 3; ++k) {
      const float value = pixels[6 * x + k], low = least[6 * x + k], high = greatest[6 * x + k];
      if (value > high ? seen(value) > seen(high) + noticed : value < low && seen(value) < seen(low) - noticed) mask[x] = 1;
    }
}

void bilinear(const MipTexels& t, int level, float u, float v, float* out) {
  const int width = t.width[level], height = t.height[level];
  double x = static_cast<double>(u) * width - 0.5, y = static_cast<double>(v) * height - 0.5;
  if (t.nearest) x = std::floor(x + 0.5), y = std::floor(y + 0.5);
  const double left = std::floor(x), top = std::floor(y);
  const float fx = static_cast<float>(x - left), fy = static_cast<float>(y - top);
  constexpr double kFar = 1e15;  // farther out no texel can be told from the next
  const int64_t column = static_cast<int64_t>(std::clamp(left, -kFar, kFar));
  const int64_t line = static_cast<int64_t>(std::clamp(top, -kFar, kFar));
  const int x0 = wrapped(column, width, t.wrap_u), x1 = wrapped(column + 1, width, t.wrap_u);
  const int64_t y0 = t.start[level] + static_cast<int64_t>(wrapped(line, height, t.wrap_v)) * width;
  const int64_t y1 = t.start[level] + static_cast<int64_t>(wrapped(line + 1, height, t.wrap_v)) * width;
  const uint8_t* corners[4] = {t.texels + 4 * (y0 + x0), t.texels + 4 * (y0 + x1), t.texels + 4 * (y1 + x0),
                               t.texels + 4 * (y1 + x1)};
  for (int k = 0; k < 4; ++k) {
    const auto texel = [&](int i) { return k < 3 ? t.meaning[corners[i][k]] : corners[i][3] / 255.0f; };
    const float upper = texel(0) * (1 - fx) + texel(1) * fx, lower = texel(2) * (1 - fx) + texel(3) * fx;
    out[k] = upper * (1 - fy) + lower * fy;
  }
}

}  // namespace

void to_srgb(const float* linear, int64_t count, float* out) {
  const Srgb& curve = Srgb::curve();
  for (int64_t i = 0; i < count; ++i) out[i] = curve.encoded(linear[i]);
}

void finish(const float* rgba, int64_t count, const Ground& ground, float* out) {
  const Srgb& curve = Srgb::curve();
  for (int64_t i = 0; i < count; ++i) {
    const float rest = 1 - std::min(rgba[4 * i + 3], 1.0f);
    for (int k = 0; k < 3; ++k) {
      const float value = rgba[4 * i + k] + rest * ground.colour[k];
      out[3 * i + k] = ground.linear ? curve.encoded(value) : std::clamp(value, 0.0f, 1.0f);
    }
  }
}

void shrink(const float* rgba, int from, int size, float* out) {
  const auto parts = areas(from, size);
  Plane sums(static_cast<size_t>(from) * 4);
  for (int y = 0; y < size; ++y) {
    const auto [top, bottom] = parts[y];
    std::copy_n(rgba + static_cast<size_t>(top) * from * 4, sums.size(), sums.begin());
    for (int line = top + 1; line <= bottom; ++line) {
      const float* row = rgba + static_cast<size_t>(line) * from * 4;
      for (size_t i = 0; i < sums.size(); ++i) sums[i] += row[i];
    }
    for (int x = 0; x < size; ++x, out += 4) {
      const auto [left, right] = parts[x];
      const float share = 1.0f / static_cast<float>((right - left + 1) * (bottom - top + 1));
      float total[4] = {0, 0, 0, 0};
      for (int at = left; at <= right; ++at)
        for (int k = 0; k < 4; ++k) total[k] += sums[4 * at + k];
      for (int k = 0; k < 4; ++k) out[k] = total[k] * share;
    }
  }
}

Similarity similarity(const float* a, const float* b, const uint8_t* shown, int height, int width, const float* taps,
                      int radius) {
  const int wide = width + 2 * radius;
  const auto mirrored = [](int at, int size) { return at < 0 ? -1 - at : at >= size ? 2 * size - 1 - at : at; };
  Plane columns(static_cast<size_t>(wide) * 4, 0.0f), means(static_cast<size_t>(width) * 4);
  double whole = 0, structure = 0;
  int64_t count = 0;
  for (int y = 0; y < height; ++y) {
    const uint8_t* mask = shown + static_cast<size_t>(y) * width;
    if (std::find(mask, mask + width, 1) == mask + width) continue;
    float* const sums[4] = {columns.data(), columns.data() + wide, columns.data() + 2 * wide, columns.data() + 3 * wide};
    std::fill(columns.begin(), columns.end(), 0.0f);
    for (int k = -radius; k <= radius; ++k) {
      const size_t line = static_cast<size_t>(mirrored(y + k, height)) * width;
      const float *p = a + line, *q = b + line, tap = taps[std::abs(k)];
      for (int x = 0; x < width; ++x) {
        sums[0][radius + x] += tap * p[x];
        sums[1][radius + x] += tap * q[x];
        sums[2][radius + x] += tap * (p[x] * p[x] + q[x] * q[x]);
        sums[3][radius + x] += tap * (p[x] * q[x]);
      }
    }
    std::fill(means.begin(), means.end(), 0.0f);
    for (int plane = 0; plane < 4; ++plane) {
      for (int i = 1; i <= radius; ++i) {
        sums[plane][radius - i] = sums[plane][radius + mirrored(-i, width)];
        sums[plane][radius + width - 1 + i] = sums[plane][radius + mirrored(width - 1 + i, width)];
      }
      float* to = means.data() + static_cast<size_t>(plane) * width;
      for (int k = -radius; k <= radius; ++k) {
        const float *from = sums[plane] + radius + k, tap = taps[std::abs(k)];
        for (int x = 0; x < width; ++x) to[x] += tap * from[x];
      }
    }
    for (int x = 0; x < width; ++x) {
      if (!mask[x]) continue;
      const float p = means[x], q = means[width + x];
      const float variance = means[2 * width + x] - p * p - q * q, covariance = means[3 * width + x] - p * q;
      const float part = (2 * covariance + kC2) / (std::max(variance, 0.0f) + kC2);
      whole += part * ((2 * p * q + kC1) / (p * p + q * q + kC1));
      structure += part;
      ++count;
    }
  }
  return count ? Similarity{whole / count, structure / count} : Similarity{0, 0};
}

Differing differing(const float* a, const float* b, int size, int height, const Ground& ground, float noticed) {
  const int fine = 2 * height;
  Plane shrunk[2];
  const float* pictures[2] = {a, b};
  if (fine != size)
    for (int i = 0; i < 2; ++i) {
      shrunk[i].resize(static_cast<size_t>(fine) * fine * 4);
      shrink(pictures[i], size, fine, shrunk[i].data());
      pictures[i] = shrunk[i].data();
    }
  int64_t shown = 0;
  int top = height, bottom = -1, left = height, right = -1;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < height; ++x) {
      bool covered = false;
      for (const float* picture : pictures) {
        const float* alpha = picture + (static_cast<size_t>(2 * y) * fine + 2 * x) * 4 + 3;
        const float* below = alpha + static_cast<size_t>(fine) * 4;
        covered |= alpha[0] + alpha[4] + below[0] + below[4] > 0;
      }
      if (!covered) continue;
      ++shown;
      top = std::min(top, y), bottom = std::max(bottom, y), left = std::min(left, x), right = std::max(right, x);
    }
  if (!shown) return {0, 0};
  top = std::max(top - kMargin, 0), bottom = std::min(bottom + kMargin, height - 1);
  left = std::max(left - kMargin, 0), right = std::min(right + kMargin, height - 1);
  Extremes first(pictures[0], fine, 2 * top, 2 * bottom + 1, 2 * left, 2 * right + 1, ground);
  Extremes second(pictures[1], fine, 2 * top, 2 * bottom + 1, 2 * left, 2 * right + 1, ground);
  std::vector<uint8_t> above, mask(first.columns());
  Plane least, greatest;
  int64_t differ = 0;
  for (int line = 0; line < first.lines(); ++line) {
    std::fill(mask.begin(), mask.end(), 0);
    outside(first, second, line, ground, noticed, mask, least, greatest);
    outside(second, first, line, ground, noticed, mask, least, greatest);
    if (!above.empty())
      for (int x = 1; x < first.columns(); ++x) differ += above[x - 1] & above[x] & mask[x - 1] & mask[x];
    above = mask;
  }
  return {shown, differ};
}

bool blend(const float* values, int64_t rows, int columns, const int32_t* corners, const int32_t* faces,
           const float* weights, int64_t count, float* out) {
  for (int64_t i = 0; i < count; ++i) {
    const int64_t first = 3 * static_cast<int64_t>(faces[i]);
    const float* at[3];
    for (int k = 0; k < 3; ++k) {
      const int64_t row = corners ? corners[first + k] : first + k;
      if (row < 0 || row >= rows) return false;
      at[k] = values + columns * row;
    }
    const float *w = weights + 3 * i;
    float* to = out + columns * i;
    for (int c = 0; c < columns; ++c) to[c] = at[0][c] * w[0] + at[1][c] * w[1] + at[2][c] * w[2];
  }
  return true;
}

void sample(const MipTexels& texture, const float* uv, const float* footprint, int64_t count, float* out) {
  const float coarsest = static_cast<float>(texture.levels - 1);
  const auto finite = [](float value) { return std::isfinite(value) ? value : 0.0f; };
  for (int64_t i = 0; i < count; ++i, out += 4) {
    const float u = finite(uv[2 * i]), v = finite(uv[2 * i + 1]);
    const float size = footprint ? footprint[i] : 1.0f;
    const float level = size > 1 ? std::min(std::log2(size), coarsest) : 0.0f;
    const int lower = static_cast<int>(level);
    const float part = level - static_cast<float>(lower);
    bilinear(texture, lower, u, v, out);
    if (part > 0) {
      float coarse[4];
      bilinear(texture, lower + 1, u, v, coarse);
      for (int k = 0; k < 4; ++k) out[k] += (coarse[k] - out[k]) * part;
    }
  }
}

}  // namespace lodpipe
