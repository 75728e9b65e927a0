// Fourier transforms of rows of 2^k complex numbers in single precision, one row a lane.
//
// The spectrum stands in bit-reversed order: there and back, nothing is reordered.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "clones.h"

namespace hpc {

constexpr int ROWS = 16;

// The same element of each row.
struct Element {
  float re[ROWS], im[ROWS];
};

#define EACH_ROW for (int lane = 0; lane < ROWS; ++lane)

// What transforms of one length share.
struct Fourier {
  int64_t nodes;
  std::vector<float> cosine, sine;  // of the first half of the circle
  std::vector<int64_t> place;       // of each frequency in the spectrum
  std::vector<float> frequency;     // at each place, in radians a node

  explicit Fourier(int64_t count) : nodes(count), cosine(count / 2), sine(count / 2), place(count, 0), frequency(count) {
    const double step = 2.0 * std::acos(-1.0) / static_cast<double>(count);
    for (int64_t i = 0; i < count / 2; ++i) {
      cosine[i] = static_cast<float>(std::cos(step * static_cast<double>(i)));
      sine[i] = static_cast<float>(std::sin(step * static_cast<double>(i)));
    }
    for (int64_t i = 1; i < count; ++i) place[i] = place[i / 2] / 2 + (i & 1) * (count / 2);
    for (int64_t i = 0; i < count; ++i)
      frequency[place[i]] = static_cast<float>(step * static_cast<double>(i < count / 2 ? i : i - count));
  }
};

// From values to their spectrum.
HPC_INLINE void transform(const Fourier& fourier, Element* values) {
  for (int64_t half = fourier.nodes / 2; half; half /= 2)
    for (int64_t j = 0; j < half; ++j) {
      const int64_t turn = j * (fourier.nodes / 2 / half);
      const float c = fourier.cosine[turn], s = -fourier.sine[turn];
      for (int64_t i = j; i < fourier.nodes; i += 2 * half) {
        const Element a = values[i], b = values[i + half];
        Element sum, turned;
        EACH_ROW {
          const float re = a.re[lane] - b.re[lane], im = a.im[lane] - b.im[lane];
          sum.re[lane] = a.re[lane] + b.re[lane];
          sum.im[lane] = a.im[lane] + b.im[lane];
          turned.re[lane] = re * c - im * s;
          turned.im[lane] = re * s + im * c;
        }
        values[i] = sum;
        values[i + half] = turned;
      }
    }
}

// From a spectrum to the values, times their number.
HPC_INLINE void transform_back(const Fourier& fourier, Element* values) {
  for (int64_t half = 1; half < fourier.nodes; half *= 2)
    for (int64_t j = 0; j < half; ++j) {
      const int64_t turn = j * (fourier.nodes / 2 / half);
      const float c = fourier.cosine[turn], s = fourier.sine[turn];
      for (int64_t i = j; i < fourier.nodes; i += 2 * half) {
        const Element a = values[i], b = values[i + half];
        Element sum, difference;
        EACH_ROW {
          const float re = b.re[lane] * c - b.im[lane] * s, im = b.re[lane] * s + b.im[lane] * c;
          sum.re[lane] = a.re[lane] + re;
          sum.im[lane] = a.im[lane] + im;
          difference.re[lane] = a.re[lane] - re;
          difference.im[lane] = a.im[lane] - im;
        }
        values[i] = sum;
        values[i + half] = difference;
      }
    }
}

}  // namespace hpc
