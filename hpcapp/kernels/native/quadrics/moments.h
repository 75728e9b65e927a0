// The layout of a row of moments (see moments.py), and moving blocks of rows to other centres.
#pragma once

#include <cstdint>
#include <utility>

#include "constants.h"
#include "transpose.h"

namespace hpc {

using constants::BASIS, constants::COLUMNS, constants::MONOMIALS;
constexpr int SOURCES = 20;  // monomials of degree 3 and less come first
// Rows are worked on in blocks of so many, one lane each.
constexpr int LANES = 8;
#define EACH_LANE HPC_LANES for (int lane = 0; lane < LANES; ++lane)

struct Exponent {
  int power[3];
};

constexpr Exponent EXPONENTS[MONOMIALS] = {
    {{0, 0, 0}}, {{1, 0, 0}}, {{0, 1, 0}}, {{0, 0, 1}}, {{2, 0, 0}}, {{0, 2, 0}}, {{0, 0, 2}},
    {{1, 1, 0}}, {{0, 1, 1}}, {{1, 0, 1}}, {{3, 0, 0}}, {{2, 1, 0}}, {{2, 0, 1}}, {{1, 2, 0}},
    {{1, 1, 1}}, {{1, 0, 2}}, {{0, 3, 0}}, {{0, 2, 1}}, {{0, 1, 2}}, {{0, 0, 3}}, {{4, 0, 0}},
    {{3, 1, 0}}, {{3, 0, 1}}, {{2, 2, 0}}, {{2, 1, 1}}, {{2, 0, 2}}, {{1, 3, 0}}, {{1, 2, 1}},
    {{1, 1, 2}}, {{1, 0, 3}}, {{0, 4, 0}}, {{0, 3, 1}}, {{0, 2, 2}}, {{0, 1, 3}}, {{0, 0, 4}}};

constexpr int column_of(int a, int b, int c) {
  for (int i = 0; i < MONOMIALS; ++i)
    if (EXPONENTS[i].power[0] == a && EXPONENTS[i].power[1] == b && EXPONENTS[i].power[2] == c)
      return i;
  return -1;
}

// Return the column of a monomial with one power lowered, -1 where there is none.
constexpr int lowered(int column, int axis, int by) {
  int power[3] = {EXPONENTS[column].power[0], EXPONENTS[column].power[1],
                  EXPONENTS[column].power[2]};
  power[axis] -= by;
  return power[axis] < 0 ? -1 : column_of(power[0], power[1], power[2]);
}

constexpr double binomial(int n, int k) {
  double value = 1.0;
  for (int i = 0; i < k; ++i) value = value * (n - i) / (i + 1);
  return value;
}

// One term of a shift: column += factor * step^power * source.
struct ShiftTerm {
  int column, source, power;
  double factor;
};

struct ShiftTable {
  ShiftTerm terms[3][35];
  constexpr ShiftTable() : terms() {
    for (int axis = 0; axis < 3; ++axis) {
      int count = 0;
      // Columns of high power come first: each reads only columns that are not shifted yet.
      for (int power = 4; power > 0; --power)
        for (int column = 0; column < MONOMIALS; ++column)
          if (EXPONENTS[column].power[axis] == power)
            for (int by = 1; by <= power; ++by)
              terms[axis][count++] = {column, lowered(column, axis, by), by, binomial(power, by)};
    }
  }
};

constexpr ShiftTable SHIFTS;

using Block = double[COLUMNS][LANES];

template <int AXIS, int TERM>
HPC_INLINE void shift_term(Block& sum, const Block& difference) {
  constexpr double HALVES[4] = {0.5, 0.25, 0.125, 0.0625};
  constexpr ShiftTerm term = SHIFTS.terms[AXIS][TERM];
  constexpr double factor = term.factor * HALVES[term.power - 1];
  // A source is summed already, and not shifted yet.
  const double* from = term.power % 2 ? difference[term.source] : sum[term.source];
  double* to = sum[term.column];
  EACH_LANE to[lane] += factor * from[lane];
}

// One after the other at compile time: what a term reads and writes is no longer looked up.
template <int AXIS, int... TERM>
HPC_INLINE void shift_terms(Block& sum, const Block& difference, std::integer_sequence<int, TERM...>) {
  (shift_term<AXIS, TERM>(sum, difference), ...);
}

// Sum two blocks about the centre between them: `low` lies half a cell below it along an axis,
// `high` half a cell above. Even powers of the shift see the sum, odd ones the difference.
template <int AXIS>
HPC_INLINE void sum_pair(const Block& low, const Block& high, Block& sum) {
  Block difference;
  for (int column = 0; column < COLUMNS; ++column) EACH_LANE sum[column][lane] = low[column][lane] + high[column][lane];
  // Only moments of degree 3 and less, and those of the normals alone, are shifted into others.
  for (int column = 0; column < SOURCES; ++column)
    EACH_LANE difference[column][lane] = high[column][lane] - low[column][lane];
  for (int column = MONOMIALS; column < MONOMIALS + 3; ++column)
    EACH_LANE difference[column][lane] = high[column][lane] - low[column][lane];
  shift_terms<AXIS>(sum, difference, std::make_integer_sequence<int, 35>());
  for (const auto& term : constants::moments::NORMAL_SHIFTS)
    if (term[2] == AXIS) EACH_LANE sum[term[0]][lane] += (0.5 * term[3]) * difference[term[1]][lane];
}

// Load rows of moments, one lane each; zeros where a row is -1.
HPC_INLINE void load_rows(const double* moments, const int64_t* rows, Block& block) {
  static constexpr double NONE[COLUMNS] = {};
  static_assert(LANES % 4 == 0 && COLUMNS % 4 == 0, "moved four by four");
  for (int lane = 0; lane < LANES; lane += 4) {
    const double* from[4];
    for (int i = 0; i < 4; ++i) from[i] = rows[lane + i] < 0 ? NONE : moments + rows[lane + i] * COLUMNS;
    for (int column = 0; column < COLUMNS; column += 4) {
      transpose_four(from, &block[column][lane], LANES);
      for (auto& row : from) row += 4;
    }
  }
}

// Store a block as rows of moments.
HPC_INLINE void store_rows(const Block& block, double* rows) {
  for (int lane = 0; lane < LANES; lane += 4)
    for (int column = 0; column < COLUMNS; column += 4) {
      const double* from[4];
      for (int i = 0; i < 4; ++i) from[i] = &block[column + i][lane];
      transpose_four(from, rows + lane * COLUMNS + column, COLUMNS);
    }
}

}  // namespace hpc
