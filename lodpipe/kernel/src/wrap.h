// What a texture shows beyond its border.
#pragma once
#include <algorithm>
#include <cstdint>

namespace lodpipe {

enum class Wrap { repeat, mirror, clamp };

// The texel 0 … size − 1 that stands for any integer.
inline int wrapped(int64_t i, int size, Wrap mode) {
  if (i >= 0 && i < size) return static_cast<int>(i);
  if (mode == Wrap::clamp) return static_cast<int>(std::clamp<int64_t>(i, 0, size - 1));
  const int64_t period = mode == Wrap::mirror ? 2 * static_cast<int64_t>(size) : size;
  int64_t within = i % period;
  if (within < 0) within += period;
  return static_cast<int>(within < size ? within : period - 1 - within);
}

}  // namespace lodpipe
