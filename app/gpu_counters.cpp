#include "app/gpu_counters.h"

#include <fmt/format.h>

#include <set>
#include <utility>

#include "probe/names.h"

namespace energyprof::app {

std::string counters_fix(const probe::Root& root, const kernels::DeviceInfo& info) {
  constexpr uint32_t intel = 0x8086;
  if (info.vendor_id != intel || !info.performance_counters.empty()) return {};
  std::string command;
  for (const auto& [file, key] :
       {std::pair{"proc/sys/dev/i915/perf_stream_paranoid", "dev.i915.perf_stream_paranoid"},
        std::pair{"proc/sys/dev/xe/observation_paranoid", "dev.xe.observation_paranoid"}})
    if (root.read_line(file).value_or("0") != "0")
      command += fmt::format("{} {}=0", command.empty() ? "sudo sysctl" : "", key);
  return command;
}

std::vector<Channel> counter_channels(const kernels::DeviceInfo& info, int32_t first_id) {
  std::vector<Channel> channels;
  std::set<std::string> taken;
  for (const kernels::PerformanceCounter& counter : info.performance_counters) {
    if (!counter.is_chosen) continue;
    Channel channel;
    channel.id = first_id + static_cast<int32_t>(channels.size());
    const std::string name = "vkperf." + probe::slug(counter.name);
    channel.name = name;
    for (int copy = 2; !taken.insert(channel.name).second; ++copy)
      channel.name = fmt::format("{}#{}", name, copy);
    channel.source = "vkperf";
    channel.quantity = counter.quantity;
    channel.unit = counter.channel_unit;
    channel.kind = Kind::gauge;
    channel.gpu = info.pci_address.value_or("");
    channel.origin = fmt::format("VK_KHR_performance_query: {}, {}: {}", counter.category,
                                 counter.name, counter.description);
    channels.push_back(std::move(channel));
  }
  return channels;
}

std::vector<Sample> counter_samples(const std::vector<Channel>& channels,
                                    const kernels::HardwareCounts& counts) {
  std::vector<Sample> samples;
  if (counts.values.size() != channels.size()) return samples;
  for (size_t i = 0; i < channels.size(); ++i) {
    if (!counts.values[i]) continue;
    Sample sample;
    sample.channel_id = channels[i].id;
    sample.t_ns = counts.end_ns;
    sample.value = *counts.values[i];
    samples.push_back(sample);
  }
  return samples;
}

}  // namespace energyprof::app
