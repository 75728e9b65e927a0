// The extension hpcapp.applications.surface.kernels._native: the kernels of every family, under their numpy names.
#include "families.h"
#include "memory.h"

namespace nb = nanobind;

NB_MODULE(_native, module) {
  hpc::give_back_large_arrays();
  module.attr("KERNEL_HASH") = HPC_KERNEL_HASH;
  module.def("keep_memory", &hpc::keep_memory, nb::arg("is_on"));
  module.def("bound_free_memory", &hpc::bound_free_memory, nb::arg("most_bytes"));
  hpc::bind_points(module);
  hpc::bind_packing(module);
  hpc::bind_lattice(module);
  hpc::bind_outliers(module);
  hpc::bind_neighbours(module);
  hpc::bind_moments(module);
  hpc::bind_hermite(module);
  hpc::bind_inheritance(module);
  hpc::bind_far_field(module);
  hpc::bind_poisson(module);
  hpc::bind_field(module);
  hpc::bind_surface(module);
  hpc::bind_topology(module);
  hpc::bind_robust(module);
  hpc::bind_seams(module);
  hpc::bind_balance(module);
  hpc::bind_features(module);
  hpc::bind_planes(module);
  hpc::bind_links(module);
  hpc::bind_sheets(module);
  hpc::bind_collapse(module);
  nb::list names;
  for (const auto [name, kernel] : nb::borrow<nb::dict>(module.attr("__dict__")))
    if (nb::isinstance<nb::callable>(kernel)) names.append(name);
  module.attr("__all__") = names;
}
