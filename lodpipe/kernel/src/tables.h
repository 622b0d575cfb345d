// Tables of numbers in text files, and equal rows of tables.
#pragma once
#include <cstdint>
#include <vector>

namespace lodpipe {

struct TextLines {
  std::vector<int64_t> start, end, first;  // of each line, without its \n; and its first word (the end where there is none)
  std::vector<int32_t> words;              // words of each line
  std::vector<uint64_t> head;              // the eight bytes from the first word on, spaces after the text's end
};

// Lines end at \n; words are what white space (\t \n \v \f \r and the space) separates.
TextLines text_lines(const char* text, int64_t size);

// The numbers at `at[i]` … `end[i]` of `text`, up to `columns` of each of `count` lines, into rows of `values`, NaN where a
// line has fewer. False if one of them is not a plain decimal number (nan, inf, out of range, something else).
bool text_numbers(const char* text, const int64_t* at, const int64_t* end, int64_t count, int columns, int threads,
                  double* values);

// The words v, v/t, v//n and v/t/n at `at[i]` … `end[i]` of `text`; those of line i go to the rows from begin[i] on, 0 where
// a word names none. False if a word is something else or does not fit into 32 bits.
bool text_corners(const char* text, const int64_t* at, const int64_t* end, const int64_t* begin, int64_t count,
                  int threads, int32_t* vertex, int32_t* uv, int32_t* normal);

struct UniqueRows {
  std::vector<int32_t> first, inverse;  // the row where each distinct row appears first, ascending; each row's place there
};
// Equal rows of a table of `columns` words of 32 bits.
UniqueRows unique_rows(const uint32_t* rows, int count, int columns);

}  // namespace lodpipe
