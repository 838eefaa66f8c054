#include "probe/gpu_match.h"

#include <fmt/format.h>

#include <map>
#include <set>

#include "probe/drm_card.h"

namespace energyprof::probe {

std::optional<std::string> gpu_of(const Root& root, const TracingDevice& device) {
  if (device.is_cpu) return std::nullopt;
  if (device.pci_address) return device.pci_address;
  for (const auto& [major, minor] : device.drm_nodes)
    if (auto gpu = gpu_of_drm_node(root, major, minor)) return gpu;
  return std::nullopt;
}

void keep_gpu(Discovery& discovery, const Root& root, const TracingDevice& device) {
  std::set<std::string> sensed;
  for (const auto& source : discovery.sources)
    if (!source->traits().gpu.empty()) sensed.insert(source->traits().gpu);
  std::optional<std::string> gpu = gpu_of(root, device);
  for (const auto& source : discovery.sources)
    if (!device.is_cpu && !device.uuid.empty() && source->traits().gpu_uuid == device.uuid)
      gpu = source->traits().gpu;
  std::string why;
  if (device.is_cpu) {
    why = fmt::format(
        "the frames are traced by '{}', on the CPU: no GPU's sensor can explain them; "
        "package energy and the CPU's sensors can",
        device.name);
  } else if (gpu) {
    why = fmt::format("the frames are traced by '{}', which is {}", device.name, *gpu);
  } else {
    if (sensed.size() == 1) gpu = *sensed.begin();
    why = fmt::format("'{}' does not say which card of the kernel's it is", device.name);
  }
  std::map<std::pair<std::string, std::string>, size_t> removed;  // source, GPU -> channels
  std::erase_if(discovery.sources, [&](const auto& source) {
    const std::string& of = source->traits().gpu;
    if (of.empty() || (gpu && of == *gpu)) return false;
    removed[{std::string(source->name()), of}] += source->channels().size();
    return true;
  });
  for (const auto& [from, channel_count] : removed)
    discovery.missing.push_back(
        {from.first,
         fmt::format("{} channels of the GPU {} are left out: {}", channel_count, from.second, why),
         ""});
  if (device.is_cpu && removed.empty()) discovery.missing.push_back({"gpu", why, ""});
  if (!device.is_cpu && (!gpu || !sensed.contains(*gpu)))
    discovery.missing.push_back(
        {"gpu", fmt::format("no sensor of the GPU that traces: {}", why), ""});
}

}  // namespace energyprof::probe
