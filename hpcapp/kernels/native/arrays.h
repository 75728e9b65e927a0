// The border between Python and the kernels: arrays are checked here once, and trusted inside.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "interruption.h"
#include "memory.h"

namespace hpc {

namespace nb = nanobind;
using namespace nb::literals;

// An array as it comes, to be checked.
using Input = nb::ndarray<nb::ro, nb::device::cpu>;

// An array that is converted first where it is of another type or order; see its caster below.
template <class Array>
struct Converted : Input {};
using Contiguous = Converted<nb::ndarray<nb::ro, nb::c_contig, nb::device::cpu>>;
using Doubles = Converted<nb::ndarray<const double, nb::c_contig, nb::device::cpu>>;
using Singles = Converted<nb::ndarray<const float, nb::c_contig, nb::device::cpu>>;
using Integers = Converted<nb::ndarray<const int64_t, nb::c_contig, nb::device::cpu>>;
using Bytes = Converted<nb::ndarray<const uint8_t, nb::c_contig, nb::device::cpu>>;

template <class T>
using Output = nb::ndarray<nb::numpy, T>;

constexpr int64_t ANY = -1;

[[noreturn]] inline void refuse(const std::string& problem) { throw std::invalid_argument(problem); }

// Return the data of a C-contiguous array of T; ANY stands for a side of any length.
template <class T>
const T* check(const Input& array, const char* name, std::initializer_list<int64_t> shape) {
  if (array.dtype() != nb::dtype<T>())
    refuse(std::string(name) + ": expected another dtype");
  bool fits = array.ndim() == shape.size();
  size_t axis = 0;
  if (fits)
    for (int64_t side : shape) {
      fits = fits && (side == ANY || array.shape(axis) == static_cast<size_t>(side));
      ++axis;
    }
  if (!fits) refuse(std::string(name) + ": expected another shape");
  int64_t stride = 1;
  if (array.size())
    for (size_t i = shape.size(); i-- > 0;) {
      if (array.shape(i) != 1 && array.stride(i) != stride)
        refuse(std::string(name) + ": expected a C-contiguous array");
      stride *= static_cast<int64_t>(array.shape(i));
    }
  return static_cast<const T*>(array.data());
}

inline int64_t rows_of(const Input& array) { return static_cast<int64_t>(array.shape(0)); }

inline void check_positive(double value, const char* name) {
  if (!(value > 0.0) || !std::isfinite(value))
    refuse(std::string(name) + ": expected a positive, finite number");
}

inline void check_finite(const double* values, int64_t count, const char* name) {
  for (int64_t i = 0; i < count; ++i)
    if (!std::isfinite(values[i])) refuse(std::string(name) + ": expected finite numbers");
}

inline int check_threads(int64_t threads) {
  if (threads < 1 || threads > 1024) refuse("threads: expected 1 to 1024");
  return static_cast<int>(threads);
}

// Keys index everything by search: they must be sorted, unique and not negative.
inline const int64_t* check_keys(const Input& array, const char* name) {
  const int64_t* keys = check<int64_t>(array, name, {ANY});
  const int64_t count = rows_of(array);
  for (int64_t i = 0; i < count; ++i)
    if (keys[i] < 0 || (i && keys[i] <= keys[i - 1]))
      refuse(std::string(name) + ": expected sorted, unique keys");
  if (count > INT32_MAX - 64) refuse(std::string(name) + ": too many keys");
  return keys;
}

// Check that cell i holds the points offsets[i] to offsets[i + 1], and that these are all.
inline const int64_t* check_offsets(const Input& offsets_of, int64_t cells, int64_t points) {
  const int64_t* offsets = check<int64_t>(offsets_of, "offsets", {cells == ANY ? ANY : cells + 1});
  cells = rows_of(offsets_of) - 1;
  if (cells < 0 || offsets[0] != 0 || offsets[cells] != points)
    refuse("offsets: expected to run from 0 to the number of points");
  for (int64_t cell = 0; cell < cells; ++cell)
    if (offsets[cell] > offsets[cell + 1]) refuse("offsets: expected to rise");
  return offsets;
}

// Faces whose vertices are all there.
inline const int64_t* check_faces(const Input& faces_of, int64_t vertices) {
  const int64_t* faces = check<int64_t>(faces_of, "faces", {ANY, 3});
  const int64_t count = 3 * rows_of(faces_of);
  if (vertices < 0 || vertices >= INT32_MAX || count >= INT32_MAX) refuse("faces: too many, or too many vertices");
  for (int64_t i = 0; i < count; ++i)
    if (faces[i] < 0 || faces[i] >= vertices) refuse("faces: a vertex that is not there");
  return faces;
}

inline const int64_t* check_rows(const Input& array, const char* name, int64_t end) {
  const int64_t* rows = check<int64_t>(array, name, {ANY});
  for (int64_t i = 0; i < rows_of(array); ++i)
    if (rows[i] < 0 || rows[i] >= end) refuse(std::string(name) + ": a row is out of range");
  return rows;
}

template <class T>
Output<T> give(Buffer<T> data, std::initializer_list<size_t> shape) {
  T* raw = data.release();
  nb::capsule owner(raw, [](void* pointer) noexcept { Release()(pointer); });
  return Output<T>(raw, shape, owner);
}

template <class T>
Output<T> give(Large<T>&& values) {
  auto* kept = new Large<T>(std::move(values));
  nb::capsule owner(kept, [](void* pointer) noexcept { delete static_cast<Large<T>*>(pointer); });
  return Output<T>(kept->data(), {kept->size()}, owner);
}

// Return what Python defines in a module of the kernels.
inline nb::object python_object(const char* module, const char* name) {
  return nb::module_::import_((std::string("hpcapp.kernels.") + module).c_str()).attr(name);
}

// Return a field of a record of Python.
template <class T>
T field_of(nb::handle record, const char* name) {
  T value{};
  if (!nb::hasattr(record, name) || !nb::try_cast(nb::object(record.attr(name)), value))
    refuse(std::string(name) + ": missing, or of another type");
  return value;
}

// What defines the kernels of each file; module.cpp calls all of it.
inline std::vector<void (*)(nb::module_&)>& definitions() {
  static std::vector<void (*)(nb::module_&)> all;
  return all;
}

}  // namespace hpc

// Begins the body of the function that defines a file's kernels, in `module`, by their numpy names.
#define HPC_KERNELS                                                                                \
  static void define_kernels(nb::module_& module);                                                 \
  [[maybe_unused]] static const bool are_listed = (definitions().push_back(define_kernels), true); \
  static void define_kernels(nb::module_& module)

namespace nanobind::detail {

// What cannot be converted is passed on, for `check` to refuse by name.
template <class Array>
struct type_caster<hpc::Converted<Array>> {
  NB_TYPE_CASTER(hpc::Converted<Array>, make_caster<Array>::Name)

  bool from_python(handle given, uint32_t flags, cleanup_list* cleanup) noexcept {
    make_caster<Array> converted;
    if (converted.from_python(given, flags, cleanup)) {
      static_cast<hpc::Input&>(value) = hpc::Input(converted.value);
      return true;
    }
    make_caster<hpc::Input> unconverted;
    if (!unconverted.from_python(given, flags, cleanup)) return false;
    static_cast<hpc::Input&>(value) = std::move(unconverted.value);
    return true;
  }
};

}  // namespace nanobind::detail
