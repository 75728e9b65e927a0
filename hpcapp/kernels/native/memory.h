// Memory for large arrays: in huge pages where the system has them and given back when it is freed,
// or kept.
#pragma once

#include <climits>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif
#if defined(__GLIBC__)
#include <malloc.h>
#endif

namespace hpc {

constexpr size_t HUGE_PAGE = size_t{1} << 21;

inline bool is_kept = false;  // memory that was freed, for what is asked for next

// Have large arrays, numpy's too, given back to the system when they are freed, unless who started
// the process says otherwise. By itself glibc keeps arrays of up to 32 MB once one of that size was
// freed, in pieces, for each thread. Smaller ones are used again, by whichever thread asks next.
inline void give_back_large_arrays() {
  is_kept = std::getenv("MALLOC_TRIM_THRESHOLD_");
#if defined(__GLIBC__)
  mallopt(M_ARENA_MAX, 1);
  if (is_kept) return;
  mallopt(M_MMAP_MAX, 1 << 16);
  mallopt(M_MMAP_THRESHOLD, 1 << 22);
  mallopt(M_TRIM_THRESHOLD, 1 << 23);
#endif
}

// Keep what is freed, and use it again, or no more. The first touch of fresh memory may cost twenty
// times what it is filled with, above all on a virtual machine; but what was the most stays the most.
inline void keep_memory(bool is_on) {
  if (!is_on) return give_back_large_arrays();
  is_kept = true;
#if defined(__GLIBC__)
  mallopt(M_MMAP_MAX, 0);
  mallopt(M_TRIM_THRESHOLD, INT_MAX);
#endif
}

// Give back all that is free.
inline void give_back_memory() {
#if defined(__GLIBC__)
  malloc_trim(0);
#endif
}

// Give back all that is free if it is as much as that: pieces that did not fit what was asked for.
// Less is sooner used again.
inline void bound_free_memory(size_t bytes) {
#if defined(__GLIBC__)
#if __GLIBC_PREREQ(2, 33)
  if (mallinfo2().fordblks < bytes) return;
#endif
  malloc_trim(0);
#endif
}

// Give back what smaller arrays leave behind, unless it is kept: before one asks for large ones.
inline void give_back_rest() {
  if (!is_kept) give_back_memory();
}

inline void* take_memory(size_t bytes) {
#if defined(__linux__)
  // Page by page, the first touch of a large array costs more than what it is filled with. Kept
  // memory has been touched, and aligned pieces leave gaps in it that no later one fits.
  if (!is_kept && bytes >= 2 * HUGE_PAGE) {
    const size_t rounded = (bytes + HUGE_PAGE - 1) / HUGE_PAGE * HUGE_PAGE;
    void* large = std::aligned_alloc(HUGE_PAGE, rounded);
    if (!large) throw std::bad_alloc();
    madvise(large, rounded, MADV_HUGEPAGE);
    return large;
  }
#endif
  void* small = std::malloc(bytes ? bytes : 1);
  if (!small) throw std::bad_alloc();
  return small;
}

// Ask for memory that is read a few rows later, where rows come in no order.
constexpr int64_t AHEAD = 16;
inline void fetch(const void* address) {
#if defined(__GNUC__)
  __builtin_prefetch(address);
#else
  (void)address;
#endif
}

struct Release {
  void operator()(void* memory) const noexcept { std::free(memory); }
};

template <class T>
using Buffer = std::unique_ptr<T[], Release>;

// Uninitialised memory: every kernel writes all of its result.
template <class T>
Buffer<T> make_buffer(int64_t count) {
  return Buffer<T>(static_cast<T*>(take_memory(static_cast<size_t>(count > 0 ? count : 0) * sizeof(T))));
}

template <class T>
struct LargeAllocator {
  using value_type = T;
  LargeAllocator() = default;
  template <class U>
  LargeAllocator(const LargeAllocator<U>&) {}
  T* allocate(size_t count) { return static_cast<T*>(take_memory(count * sizeof(T))); }
  void deallocate(T* memory, size_t) noexcept { std::free(memory); }
  template <class U>
  bool operator==(const LargeAllocator<U>&) const { return true; }
  template <class U>
  bool operator!=(const LargeAllocator<U>&) const { return false; }
};

// A vector for as many items as there are points or cells.
template <class T>
using Large = std::vector<T, LargeAllocator<T>>;

}  // namespace hpc
