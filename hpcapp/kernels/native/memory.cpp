// How this process uses memory that it has freed (see memory.h).
#include "memory.h"

#include "arrays.h"

namespace hpc {

HPC_KERNELS {
  module.def("keep_memory", &keep_memory, "is_on"_a);
  module.def("bound_free_memory", &bound_free_memory, "most_bytes"_a);
}

}  // namespace hpc
