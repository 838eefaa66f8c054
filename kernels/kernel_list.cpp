// The table of kernels and their embedded shaders.
#include "kernels/kernel_list.h"

#include <algorithm>

#include "embedded/bvh_ftb_df_spv.h"

namespace energyprof::kernels {

const std::vector<KernelInfo>& kernel_list() {
  static const std::vector<KernelInfo> kernels{
      {"BVH_FTB_DF", AccelKind::bvh_depth_first, embedded::bvh_ftb_df_spv()},
  };
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
