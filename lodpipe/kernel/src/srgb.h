// The transfer curve of sRGB (IEC 61966-2-1), both ways, as tables between whose entries is interpolated: the same bytes
// on every machine, and an error below 1e-6.
#pragma once
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <vector>

namespace lodpipe {

class Srgb {
 public:
  static const Srgb& curve() {
    static const Srgb made;
    return made;
  }

  // The sRGB value of linear light; both clipped to 0…1. What is not a number counts as 0.
  float encoded(float linear) const {
    if (!(linear > kLinear)) return linear > 0 ? linear * 12.92f : 0.0f;
    if (linear >= 1) return 1;
    const uint32_t bits = std::bit_cast<uint32_t>(linear) - kFirst;
    const uint32_t at = bits >> kShift;
    const float part = static_cast<float>(bits & ((1u << kShift) - 1)) * (1.0f / (1u << kShift));
    return encode_[at] + part * (encode_[at + 1] - encode_[at]);
  }

  // Linear light of an sRGB value; both clipped to 0…1.
  float decoded(float value) const {
    if (!(value > 0.04045f)) return value > 0 ? value * (1 / 12.92f) : 0.0f;
    if (value >= 1) return 1;
    const float at = value * kDecode;
    const int cell = static_cast<int>(at);
    return decode_[cell] + (at - static_cast<float>(cell)) * (decode_[cell + 1] - decode_[cell]);
  }

 private:
  static constexpr float kLinear = 0.0031308f;
  static constexpr int kShift = 15, kDecode = 2048;                     // 256 entries for each factor of two
  static constexpr uint32_t kFirst = (127u - 9u) << 23, kOne = 127u << 23;  // of 2⁻⁹, of 1

  Srgb() {
    for (uint32_t bits = kFirst; bits <= kOne; bits += 1u << kShift)
      encode_.push_back(static_cast<float>(1.055 * std::pow(std::bit_cast<float>(bits), 1 / 2.4) - 0.055));
    for (int i = 0; i <= kDecode; ++i)
      decode_.push_back(static_cast<float>(std::pow((i / double{kDecode} + 0.055) / 1.055, 2.4)));
  }

  std::vector<float> encode_, decode_;
};

}  // namespace lodpipe
