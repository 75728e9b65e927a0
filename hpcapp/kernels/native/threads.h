// Chunks of rows over threads, between which a job may end: what a row gets depends on neither.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <exception>
#include <thread>
#include <vector>

#include "interruption.h"

namespace hpc {

constexpr int64_t CHUNK = 1024;  // rows: the dearest, fits of planes and features, take a tenth of a second

// Call body(start, stop) for chunks of `most` rows or fewer that cover 0..count; rethrow the first error.
template <class Body>
void run_ranges(int64_t count, int threads, const Body& body, int64_t most = CHUNK) {
  const int64_t parts = std::min<int64_t>(threads, std::max<int64_t>(count, 1));
  const int64_t chunk = std::min(most, (count + parts - 1) / parts);
  std::vector<std::exception_ptr> errors(static_cast<size_t>(parts));
  std::atomic<int64_t> next{0};
  const auto run = [&](int64_t part) {
    try {
      for (int64_t start; (start = next.fetch_add(chunk)) < count;) {
        if (part == 0) poll();
        body(start, std::min(start + chunk, count));
      }
    } catch (...) {
      errors[static_cast<size_t>(part)] = std::current_exception();
      next = count;  // for the others
    }
  };
  std::vector<std::thread> others;
  try {
    for (int64_t part = 1; part < parts; ++part) others.emplace_back(run, part);
  } catch (const std::exception&) {
    // The system gives no more threads: these do the rest.
  }
  run(0);
  for (auto& other : others) other.join();
  for (const auto& error : errors)
    if (error) std::rethrow_exception(error);
}

}  // namespace hpc
