// Rows into lanes: four rows of four numbers at a time, in registers.
#pragma once

#include <cstring>

#include "clones.h"

namespace hpc {

// Write rows[i][0..3] to to[k * stride + i].
template <class T>
HPC_INLINE void transpose_four(const T* const (&rows)[4], T* to, int64_t stride) {
#if defined(__GNUC__) && (__GNUC__ >= 12 || defined(__clang__))
  typedef T Four __attribute__((vector_size(4 * sizeof(T))));
  Four a, b, c, d;
  std::memcpy(&a, rows[0], sizeof(Four));
  std::memcpy(&b, rows[1], sizeof(Four));
  std::memcpy(&c, rows[2], sizeof(Four));
  std::memcpy(&d, rows[3], sizeof(Four));
  const Four ab_low = __builtin_shufflevector(a, b, 0, 4, 2, 6), ab_high = __builtin_shufflevector(a, b, 1, 5, 3, 7);
  const Four cd_low = __builtin_shufflevector(c, d, 0, 4, 2, 6), cd_high = __builtin_shufflevector(c, d, 1, 5, 3, 7);
  const Four columns[4] = {
      __builtin_shufflevector(ab_low, cd_low, 0, 1, 4, 5), __builtin_shufflevector(ab_high, cd_high, 0, 1, 4, 5),
      __builtin_shufflevector(ab_low, cd_low, 2, 3, 6, 7), __builtin_shufflevector(ab_high, cd_high, 2, 3, 6, 7)};
  for (int k = 0; k < 4; ++k) std::memcpy(to + k * stride, &columns[k], sizeof(Four));
#else
  for (int k = 0; k < 4; ++k)
    for (int i = 0; i < 4; ++i) to[k * stride + i] = rows[i][k];
#endif
}

}  // namespace hpc
