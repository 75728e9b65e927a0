// Several instruction sets in one library: the loader of the process picks the best one it has.
//
// Every loop that is compiled this way runs across moments, vertices or nodes, or across eight sums
// that are added up in a given order at the end, never across the points of one sum; contraction to
// fused operations is off: each version gives the same bits.
// No exception may pass through such a function: GCC takes it for one that throws none.
#pragma once

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(HPC_NO_CLONES)
#define HPC_CLONES __attribute__((target_clones("default", "avx2", "avx512f")))
#else
#define HPC_CLONES
#endif

#if defined(__GNUC__)
// What a cloned function calls must be inlined into each of its versions.
#define HPC_INLINE __attribute__((always_inline)) inline
#else
#define HPC_INLINE inline
#endif

// Before a loop over lanes, whose turns do not touch what others write. Unrolled as a whole, before
// it is vectorised, such a loop of a few turns would stay scalar.
#if defined(__GNUC__) && !defined(__clang__)
#define HPC_LANES _Pragma("GCC ivdep") _Pragma("GCC unroll 1")
// Before a loop of a few turns around such ones.
#define HPC_UNROLLED _Pragma("GCC unroll 8")
#else
#define HPC_LANES
#define HPC_UNROLLED
#endif
