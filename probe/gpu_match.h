/// Which of the GPUs that are sensed is the one that traces.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// A Vulkan device, as far as it tells which card of the kernel's it is.
struct TracingDevice {
  std::string name;
  bool is_cpu = false;                                 ///< a driver that runs on the processor
  std::optional<std::string> pci_address;              ///< "0000:03:00.0", VK_EXT_pci_bus_info
  std::vector<std::pair<int64_t, int64_t>> drm_nodes;  ///< major, minor: VK_EXT_physical_device_drm
  std::string uuid{};  ///< as SourceTraits::gpu_uuid; empty: unknown
};

/// The GPU as SourceTraits::gpu calls it; nullopt if the device does not say, or runs on the CPU.
std::optional<std::string> gpu_of(const Root& root, const TracingDevice& device);

/// Removes the sources of all GPUs but the one that traces: what another GPU does explains no
/// frame. The one that traces is known by its UUID where its source tells one, else by gpu_of().
/// Each GPU that goes becomes a Missing with the reason. A device that does not say which
/// card it is keeps the sources only where they all belong to a single GPU.
void keep_gpu(Discovery& discovery, const Root& root, const TracingDevice& device);

}  // namespace energyprof::probe
