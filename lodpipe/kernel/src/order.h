// Orders: vertices along a Morton curve (neighbours in space become neighbours in memory), and radix sorting.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "quadric.h"

namespace lodpipe {

struct Keyed {
  uint32_t key;
  int32_t id;
};

// Stable ascending sort by `key`, an unsigned integer.
template <class Item>
void radix_sort(std::vector<Item>& items, std::vector<Item>& scratch) {
  scratch.resize(items.size());
  for (int shift = 0; shift < static_cast<int>(8 * sizeof(Item::key)); shift += 11) {
    std::array<uint32_t, 2049> start{};
    for (const Item& k : items) ++start[((k.key >> shift) & 2047u) + 1];
    for (int i = 0; i < 2048; ++i) start[i + 1] += start[i];
    for (const Item& k : items) scratch[start[(k.key >> shift) & 2047u]++] = k;
    items.swap(scratch);
  }
}

inline uint32_t spread_bits(uint32_t v) {  // ten bits to every third place
  v = (v | (v << 16)) & 0x030000FFu;
  v = (v | (v << 8)) & 0x0300F00Fu;
  v = (v | (v << 4)) & 0x030C30C3u;
  return (v | (v << 2)) & 0x09249249u;
}

// `p` within [−1, 1]³.
inline uint32_t morton(Vec3 p) {
  const auto bits = [](float x) {
    const float q = (x + 1) * 512;
    return static_cast<uint32_t>(q < 0 ? 0 : q > 1023 ? 1023 : q);
  };
  return spread_bits(bits(p.x)) | spread_bits(bits(p.y)) << 1 | spread_bits(bits(p.z)) << 2;
}

}  // namespace lodpipe
