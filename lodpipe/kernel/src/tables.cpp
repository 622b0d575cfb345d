#include "tables.h"

#include <atomic>
#include <bit>
#include <charconv>
#include <cstring>
#include <limits>

#include "memory.h"
#include "parallel.h"

namespace lodpipe {

namespace {

constexpr int64_t kGrain = 1 << 14;  // lines that a thread takes at once

bool is_space(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }
bool is_digit(char c) { return c >= '0' && c <= '9'; }

const char* past_spaces(const char* at, const char* end) {
  while (at < end && is_space(*at)) ++at;
  return at;
}

// A signed integer of 32 bits at `at`, which it moves on; false if there is none.
bool integer(const char*& at, const char* end, int32_t& value) {
  const bool negative = at < end && *at == '-';
  if (at < end && (*at == '-' || *at == '+')) ++at;
  if (at == end || !is_digit(*at)) return false;
  int64_t sum = 0;
  for (; at < end && is_digit(*at); ++at)
    if ((sum = 10 * sum + (*at - '0')) > std::numeric_limits<int32_t>::max()) return false;
  value = static_cast<int32_t>(negative ? -sum : sum);
  return true;
}

// body(i) of all lines, until one is false.
template <class Body>
bool for_lines(int64_t count, int threads, const Body& body) {
  std::atomic<bool> good{true};
  Pool pool(static_cast<int>(std::min<int64_t>(threads, (count + kGrain - 1) / kGrain)));
  pool.run(static_cast<int>((count + kGrain - 1) / kGrain), [&](int part) {
    const int64_t end = std::min(count, (part + 1) * kGrain);
    for (int64_t i = part * kGrain; i < end && good.load(std::memory_order_relaxed); ++i)
      if (!body(i)) good = false;
  });
  return good;
}

}  // namespace

TextLines text_lines(const char* text, int64_t size) {
  TextLines out;
  const char* const end = text + size;
  size_t lines = 1;
  for (const char* at = text; (at = static_cast<const char*>(std::memchr(at, '\n', end - at))); ++at) ++lines;
  out.start.reserve(lines), out.end.reserve(lines), out.first.reserve(lines);
  out.words.reserve(lines), out.head.reserve(lines);
  for (const char* line = text;;) {
    const void* found = line < end ? std::memchr(line, '\n', end - line) : nullptr;
    const char* const stop = found ? static_cast<const char*>(found) : end;
    const char* const first = past_spaces(line, stop);
    int32_t words = 0;
    bool inside = false;
    for (const char* at = first; at < stop; ++at) {
      const bool space = is_space(*at);
      words += !space && !inside;
      inside = !space;
    }
    char head[8];
    std::memset(head, ' ', 8);
    std::memcpy(head, first, std::min<int64_t>(8, end - first));
    uint64_t bits = 0;
    for (int i = 7; i >= 0; --i) bits = bits << 8 | static_cast<uint8_t>(head[i]);
    out.start.push_back(line - text);
    out.end.push_back(stop - text);
    out.first.push_back(first - text);
    out.words.push_back(words);
    out.head.push_back(bits);
    if (!found) return out;
    line = stop + 1;
  }
}

bool text_numbers(const char* text, const int64_t* at, const int64_t* end, int64_t count, int columns, int threads,
                  double* values) {
  return for_lines(count, threads, [&](int64_t i) {
    const char *p = text + at[i], *const stop = text + end[i];
    for (int k = 0; k < columns; ++k) {
      double& value = values[i * columns + k];
      p = past_spaces(p, stop);
      value = std::numeric_limits<double>::quiet_NaN();
      if (p == stop) continue;
      if (*p == '+' && p + 1 < stop && p[1] != '-') ++p;
      if (!(is_digit(*p) || *p == '-' || *p == '.') || (*p == '-' && p + 1 < stop && !is_digit(p[1]) && p[1] != '.'))
        return false;  // nan, inf
      const auto [next, error] = std::from_chars(p, stop, value);
      if (error != std::errc() || (next < stop && !is_space(*next))) return false;
      p = next;
    }
    return true;
  });
}

bool text_corners(const char* text, const int64_t* at, const int64_t* end, const int64_t* begin, int64_t count,
                  int threads, int32_t* vertex, int32_t* uv, int32_t* normal) {
  return for_lines(count, threads, [&](int64_t i) {
    const char *p = text + at[i], *const stop = text + end[i];
    for (int64_t row = begin[i]; (p = past_spaces(p, stop)) < stop; ++row) {
      int32_t* const parts[3] = {vertex + row, uv + row, normal + row};
      *parts[1] = *parts[2] = 0;
      if (!integer(p, stop, *parts[0])) return false;
      for (int k = 1; k < 3 && p < stop && *p == '/'; ++k) {
        ++p;
        if (p < stop && *p != '/' && !is_space(*p) && !integer(p, stop, *parts[k])) return false;
      }
      if (p < stop && !is_space(*p)) return false;
    }
    return true;
  });
}

UniqueRows unique_rows(const uint32_t* rows, int count, int columns) {
  UniqueRows out;
  out.inverse.resize(count);
  const size_t size = std::bit_ceil(static_cast<size_t>(count) * 2 + 1), mask = size - 1;
  Large<int32_t> table(size);  // places in `first`, −1 where free
  std::fill(table.begin(), table.end(), -1);
  const size_t width = sizeof(uint32_t) * columns;
  for (int i = 0; i < count; ++i) {
    const uint32_t* row = rows + static_cast<size_t>(i) * columns;
    uint64_t hash = 0x9E3779B97F4A7C15ull;  // mixed as SplitMix64 does (Steele et al., OOPSLA 2014)
    for (int k = 0; k < columns; ++k) {
      hash = (hash ^ row[k]) * 0xBF58476D1CE4E5B9ull;
      hash ^= hash >> 29;
    }
    hash *= 0x94D049BB133111EBull;
    size_t slot = (hash ^ hash >> 31) & mask;
    while (table[slot] >= 0 && std::memcmp(rows + static_cast<size_t>(out.first[table[slot]]) * columns, row, width))
      slot = (slot + 1) & mask;
    if (table[slot] < 0) {
      table[slot] = static_cast<int32_t>(out.first.size());
      out.first.push_back(i);
    }
    out.inverse[i] = table[slot];
  }
  return out;
}

}  // namespace lodpipe
