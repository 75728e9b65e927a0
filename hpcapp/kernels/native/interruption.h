// Kernels end when nobody waits for them any more: a signal came, or their job was cancelled.
#pragma once

#include <nanobind/nanobind.h>

#include <chrono>

namespace hpc {

constexpr std::chrono::milliseconds POLLED_EVERY{100};

// Raise what a signal or `hpcapp.cancellation` raises. To be called between pieces of work, however
// short, in the thread that Python called, with its lock or without.
inline void poll() {
  thread_local std::chrono::steady_clock::time_point next{};
  const auto now = std::chrono::steady_clock::now();
  if (now < next) return;
  next = now + POLLED_EVERY;
  const nanobind::gil_scoped_acquire locked;
  if (PyErr_CheckSignals()) throw nanobind::python_error();
  nanobind::module_::import_("hpcapp.cancellation").attr("check_cancelled")();
}

// Gives Python's lock away, as long as it lives.
class Unlocked {
 public:
  Unlocked() { poll(); }

 private:
  const nanobind::gil_scoped_release released_;
};

}  // namespace hpc
