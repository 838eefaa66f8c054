/// The traversal kernels there are, by the names of the study's algorithms.
#pragma once

#include <string_view>
#include <vector>

#include "core/accel_blob.h"

namespace energyprof::kernels {

struct KernelInfo {
  std::string_view name;   ///< "BVH_FTB_DF"
  AccelKind accel;         ///< the structure it traverses
  bool uses_stack;         ///< of AccelBlob::max_depth + 1 entries
  std::string_view spirv;  ///< its shader
};

/// Every kernel, in the order of the study.
const std::vector<KernelInfo>& kernel_list();
/// Null if there is no kernel of that name.
const KernelInfo* find_kernel(std::string_view name);
/// True if `name` can be given as TraceSetup::kernel.
bool kernel_exists(std::string_view name);

}  // namespace energyprof::kernels
