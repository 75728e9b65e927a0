// The layout of a row of moments (see moments.py), and moving blocks of rows to other centres.
#pragma once

#include <cstdint>

#include "clones.h"

namespace hpc {

constexpr int MONOMIALS = 35;
constexpr int COLUMNS = 44;
// Rows are worked on in blocks of so many, one lane each.
constexpr int LANES = 16;

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

// column, source, axis of the step, factor
constexpr int NORMAL_SHIFTS[9][4] = {{38, 35, 0, 2}, {39, 36, 1, 2}, {40, 37, 2, 2},
                                     {41, 35, 1, 1}, {41, 36, 0, 1}, {42, 36, 2, 1},
                                     {42, 37, 1, 1}, {43, 35, 2, 1}, {43, 37, 0, 1}};

using Block = double[COLUMNS][LANES];

HPC_INLINE void add_scaled(double* to, const double* from, const double* factor, double constant) {
  for (int lane = 0; lane < LANES; ++lane) to[lane] += constant * factor[lane] * from[lane];
}

// Add step[axis][lane] to every point of each lane's row.
HPC_INLINE void shift_block(Block& rows, const double (&step)[3][LANES]) {
  for (int axis = 0; axis < 3; ++axis) {
    double powers[4][LANES];
    for (int lane = 0; lane < LANES; ++lane) {
      powers[0][lane] = step[axis][lane];
      for (int p = 1; p < 4; ++p) powers[p][lane] = powers[p - 1][lane] * step[axis][lane];
    }
    for (const ShiftTerm& term : SHIFTS.terms[axis])
      add_scaled(rows[term.column], rows[term.source], powers[term.power - 1], term.factor);
  }
  for (const auto& term : NORMAL_SHIFTS)
    add_scaled(rows[term[0]], rows[term[1]], step[term[2]], term[3]);
}

}  // namespace hpc
