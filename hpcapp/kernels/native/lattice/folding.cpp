// Packed points as they lie on disk: whole numbers, each column in as many bits as it needs there.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "arrays.h"
#include "clones.h"
#include "constants.h"

namespace hpc {
namespace {

constexpr int RECORD = 6, COLUMNS = 7, MOST_BITS = 32;
constexpr int AT_ONCE = 64;  // records: a loop over them is one over lanes
constexpr int WORD = 8;      // bytes; a number of 32 bits lies in one, whatever bit it begins at
using constants::QUANTA;

template <class T>
T load(const void* from) {
  T value;
  std::memcpy(&value, from, sizeof value);
  return value;
}

HPC_INLINE uint32_t bits_of(float value) { return load<uint32_t>(&value); }
HPC_INLINE float float_of(uint32_t bits) { return load<float>(&bits); }

// Return the bits of what two components of a vector of length 1 leave to the third.
HPC_INLINE uint32_t predict(float one, float other) {
  const double left = 1.0 - static_cast<double>(one) * one - static_cast<double>(other) * other;
  return bits_of(static_cast<float>(std::sqrt(left > 0.0 ? left : 0.0)));
}

// The columns of some records: three offsets, the longest component of the normal and its sign, by
// how many steps of float32 it differs from what the others leave it, and these, sign last.
struct Columns {
  int64_t numbers[COLUMNS][AT_ONCE];
  bool are_middles;
};

HPC_CLONES void split(const float* records, int count, Columns& columns) {
  auto& numbers = columns.numbers;
  bool are_middles = true;
  for (int axis = 0; axis < 3; ++axis)
    for (int i = 0; i < count; ++i) {
      const float quanta = records[RECORD * i + axis] * static_cast<float>(QUANTA);
      const bool is_within = quanta >= 0.5f && quanta < static_cast<float>(QUANTA);
      const int32_t whole = static_cast<int32_t>(is_within ? quanta : 0.0f);
      are_middles = are_middles && static_cast<float>(whole) + 0.5f == quanta;
      numbers[axis][i] = whole;
    }
  columns.are_middles = are_middles;
  for (int i = 0; i < count; ++i) {
    const float* normal = records + RECORD * i + 3;
    const uint32_t x = bits_of(normal[0]), y = bits_of(normal[1]), z = bits_of(normal[2]);
    const uint32_t first = y << 1 > x << 1 ? y : x;
    const int64_t axis = z << 1 > first << 1 ? 2 : y << 1 > x << 1;
    const uint32_t longest = axis == 2 ? z : first;
    const uint32_t one = axis == 0 ? y : axis == 1 ? z : x, other = axis == 0 ? z : axis == 1 ? x : y;
    numbers[3][i] = 2 * axis + (longest >> 31);
    numbers[4][i] = int64_t{longest & 0x7fffffff} - predict(float_of(one), float_of(other));
    numbers[5][i] = one << 1 | one >> 31;
    numbers[6][i] = other << 1 | other >> 31;
  }
}

// How the columns of a file stand in the bytes of a record: the least of each, and its bits.
struct Layout {
  const int64_t *lows, *widths;
  int64_t size;

  Layout(const Input& lows_of, const Input& widths_of)
      : lows(check<int64_t>(lows_of, "lows", {COLUMNS})), widths(check<int64_t>(widths_of, "widths", {COLUMNS})) {
    int64_t bits = 0;
    for (int i = 0; i < COLUMNS; ++i) {
      if (widths[i] < 0 || widths[i] > MOST_BITS) refuse("widths: expected 0 to 32");
      if (std::abs(lows[i] / 2) > int64_t{1} << 32) refuse("lows: expected whole numbers of 33 bits");
      bits += widths[i];
    }
    size = std::max<int64_t>(1, (bits + 7) / 8);
  }
};

// Write some records; up to a word behind the last is written, too. Tell whether they fit.
bool fold(const Columns& columns, int count, const Layout& layout, uint8_t* folded) {
  uint64_t left_over = 0;
  for (int i = 0; i < count; ++i, folded += layout.size) {
    uint8_t* to = folded;
    uint64_t word = 0;
    int64_t at = 0;
    for (int c = 0; c < COLUMNS; ++c) {
      const uint64_t value = static_cast<uint64_t>(columns.numbers[c][i] - layout.lows[c]);
      const int64_t width = layout.widths[c];
      left_over |= value >> width;
      word |= value << at;
      if ((at += width) < 8 * WORD) continue;
      std::memcpy(to, &word, WORD);
      to += WORD;
      at -= 8 * WORD;
      word = at ? value >> (width - at) : 0;
    }
    std::memcpy(to, &word, WORD);
  }
  return !left_over;
}

// Read some records; up to a word behind the last is read, too. Tell whether they are such.
HPC_CLONES bool unfold(const uint8_t* folded, int count, const Layout& layout, float* records) {
  uint32_t numbers[COLUMNS][AT_ONCE];  // a sum of what differs by multiples of 2^32 stays the same
  int64_t at = 0;
  for (int c = 0; c < COLUMNS; ++c) {
    const uint8_t* from = folded + at / 8;
    const uint64_t mask = (uint64_t{1} << layout.widths[c]) - 1, shift = static_cast<uint64_t>(at % 8);
    const uint32_t low = static_cast<uint32_t>(layout.lows[c]);
    for (int i = 0; i < count; ++i)
      numbers[c][i] = low + static_cast<uint32_t>(load<uint64_t>(from + layout.size * i) >> shift & mask);
    at += layout.widths[c];
  }
  uint32_t longest[AT_ONCE], one[AT_ONCE], other[AT_ONCE], worst = 0;
  for (int i = 0; i < count; ++i) {
    one[i] = numbers[5][i] >> 1 | numbers[5][i] << 31;
    other[i] = numbers[6][i] >> 1 | numbers[6][i] << 31;
    longest[i] = (numbers[4][i] + predict(float_of(one[i]), float_of(other[i]))) | numbers[3][i] << 31;
    worst = std::max(worst, numbers[3][i]);
  }
  for (int i = 0; i < count; ++i) {
    float* record = records + RECORD * i;
    for (int axis = 0; axis < 3; ++axis)
      record[axis] = (static_cast<float>(static_cast<int32_t>(numbers[axis][i])) + 0.5f) / QUANTA;
    const uint32_t axis = numbers[3][i] >> 1;
    record[3] = float_of(axis == 0 ? longest[i] : axis == 1 ? other[i] : one[i]);
    record[4] = float_of(axis == 0 ? one[i] : axis == 1 ? longest[i] : other[i]);
    record[5] = float_of(axis == 0 ? other[i] : axis == 1 ? one[i] : longest[i]);
  }
  return worst < 6;
}

// Call body(first, count, columns) with some records at a time.
template <class Body>
void visit_columns(const float* records, int64_t count, const Body& body) {
  Columns columns;
  for (int64_t start = 0; start < count; start += AT_ONCE) {
    const int width = static_cast<int>(std::min<int64_t>(AT_ONCE, count - start));
    split(records + RECORD * start, width, columns);
    if (!columns.are_middles) refuse("records: expected offsets in the middles of quanta");
    body(start, width, columns);
  }
}

Output<int64_t> bound_records(Input records_of) {
  const float* records = check<float>(records_of, "records", {ANY, RECORD});
  const int64_t count = rows_of(records_of);
  if (!count) refuse("records: expected one or more");
  auto bounds = make_buffer<int64_t>(2 * COLUMNS);
  std::fill_n(bounds.get(), COLUMNS, INT64_MAX);
  std::fill_n(bounds.get() + COLUMNS, COLUMNS, INT64_MIN);
  {
    const Unlocked unlocked;
    visit_columns(records, count, [&](int64_t, int width, const Columns& columns) {
      for (int c = 0; c < COLUMNS; ++c) {
        const auto [low, high] = std::minmax_element(columns.numbers[c], columns.numbers[c] + width);
        bounds[c] = std::min(bounds[c], *low);
        bounds[COLUMNS + c] = std::max(bounds[COLUMNS + c], *high);
      }
    });
  }
  return give(std::move(bounds), {2, COLUMNS});
}

Output<uint8_t> fold_records(Input records_of, Input lows_of, Input widths_of) {
  const float* records = check<float>(records_of, "records", {ANY, RECORD});
  const int64_t count = rows_of(records_of);
  const Layout layout(lows_of, widths_of);
  auto folded = make_buffer<uint8_t>(count * layout.size + WORD);
  {
    const Unlocked unlocked;
    visit_columns(records, count, [&](int64_t first, int width, const Columns& columns) {
      if (!fold(columns, width, layout, folded.get() + layout.size * first))
        refuse("records: one does not fit into the layout");
    });
  }
  return give(std::move(folded), {static_cast<size_t>(count), static_cast<size_t>(layout.size)});
}

void unfold_records(Input folded_of, Input lows_of, Input widths_of, Input counts_of, Input starts_of,
                    nb::ndarray<float, nb::shape<-1, RECORD>, nb::c_contig, nb::device::cpu> records_of) {
  const Layout layout(lows_of, widths_of);
  const uint8_t* folded = check<uint8_t>(folded_of, "folded", {ANY, layout.size});
  int64_t left = rows_of(folded_of);
  const int64_t blocks = rows_of(counts_of), room = static_cast<int64_t>(records_of.shape(0));
  const int64_t* counts = check<int64_t>(counts_of, "counts", {ANY});
  const int64_t* starts = check<int64_t>(starts_of, "starts", {blocks});
  for (int64_t i = 0; i < blocks; ++i) {
    if (counts[i] < 0 || counts[i] > left) refuse("counts: they are not those of the records");
    if (starts[i] < 0 || starts[i] > room - counts[i]) refuse("starts: there is no room");
    left -= counts[i];
  }
  if (left) refuse("counts: they are not those of the records");
  const Unlocked unlocked;
  const uint8_t* end = folded + layout.size * rows_of(folded_of);
  uint8_t last[AT_ONCE * COLUMNS * MOST_BITS / 8 + WORD];
  for (int64_t block = 0; block < blocks; ++block) {
    float* records = records_of.data() + RECORD * starts[block];
    for (int64_t i = 0; i < counts[block]; i += AT_ONCE) {
      const int width = static_cast<int>(std::min<int64_t>(AT_ONCE, counts[block] - i));
      const int64_t bytes = layout.size * width;
      const bool is_last = end - folded < bytes + WORD;  // no room to read on
      if (is_last) std::copy_n(folded, bytes, last);
      if (!unfold(is_last ? last : folded, width, layout, records + RECORD * i))
        refuse("folded: a normal without a longest component");
      folded += bytes;
    }
  }
}

}  // namespace

HPC_KERNELS {
  module.def("bound_records", &bound_records, "records"_a);
  module.def("fold_records", &fold_records, "records"_a, "lows"_a, "widths"_a);
  module.def("unfold_records", &unfold_records, "folded"_a, "lows"_a, "widths"_a, "counts"_a, "starts"_a,
             "records"_a.noconvert());
}

}  // namespace hpc
