// The table of kernels and their embedded shaders.
#include "kernels/kernel_list.h"

#include <algorithm>

#include "core/algorithms.h"
#include "embedded/bvh_ftb_bf_spv.h"
#include "embedded/bvh_ftb_df_spv.h"
#include "embedded/bvh_stackless_df_spv.h"
#include "embedded/grid_spv.h"
#include "embedded/kd_stack_spv.h"
#include "embedded/kd_tree_spv.h"

namespace energyprof::kernels {

const std::vector<KernelInfo>& kernel_list() {
#define EP_KERNEL(name, file, kind, uses_stack, text) \
  {#name, AccelKind::kind, uses_stack, embedded::file##_spv()},
  static const std::vector<KernelInfo> kernels{EP_ALGORITHMS(EP_KERNEL)};
#undef EP_KERNEL
  return kernels;
}

const KernelInfo* find_kernel(std::string_view name) {
  const auto& kernels = kernel_list();
  const auto found = std::find_if(kernels.begin(), kernels.end(),
                                  [&](const KernelInfo& kernel) { return kernel.name == name; });
  return found == kernels.end() ? nullptr : &*found;
}

bool kernel_exists(std::string_view name) { return find_kernel(name) != nullptr; }

}  // namespace energyprof::kernels
