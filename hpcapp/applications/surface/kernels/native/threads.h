// Static ranges over threads: what a row gets never depends on how many threads there are.
#pragma once

#include <algorithm>
#include <cstdint>
#include <exception>
#include <thread>
#include <vector>

namespace hpc {

// Call body(start, stop) for ranges that cover 0..count, one per thread; rethrow the first error.
template <class Body>
void run_ranges(int64_t count, int threads, const Body& body) {
  const int64_t parts = std::min<int64_t>(threads, std::max<int64_t>(count, 1));
  if (parts <= 1) {
    body(int64_t{0}, count);
    return;
  }
  std::vector<std::exception_ptr> errors(static_cast<size_t>(parts));
  const auto run = [&](int64_t part) {
    try {
      body(count * part / parts, count * (part + 1) / parts);
    } catch (...) {
      errors[static_cast<size_t>(part)] = std::current_exception();
    }
  };
  std::vector<std::thread> others;
  int64_t started = 1;
  try {
    for (; started < parts; ++started) others.emplace_back(run, started);
  } catch (const std::exception&) {
    // The system gives no more threads: this one does the rest.
  }
  run(0);
  for (int64_t part = started; part < parts; ++part) run(part);
  for (auto& other : others) other.join();
  for (const auto& error : errors)
    if (error) std::rethrow_exception(error);
}

}  // namespace hpc
