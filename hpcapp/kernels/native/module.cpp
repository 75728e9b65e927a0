// The extension hpcapp.kernels._native: the kernels of all files, under their numpy names.
#include "arrays.h"

namespace nb = nanobind;

NB_MODULE(_native, module) {
  hpc::give_back_large_arrays();
  module.attr("KERNEL_HASH") = HPC_KERNEL_HASH;
  for (const auto define : hpc::definitions()) define(module);
  nb::list names;
  for (const auto [name, kernel] : nb::borrow<nb::dict>(module.attr("__dict__")))
    if (nb::isinstance<nb::callable>(kernel)) names.append(name);
  module.attr("__all__") = names;
}
