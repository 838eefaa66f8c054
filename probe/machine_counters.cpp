#include "probe/machine_counters.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <map>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/names.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr int64_t energy_period_ns = ns_per_ms;  // RAPL counters move about every 0.976 ms
constexpr int64_t counter_period_ns = 10 * ns_per_ms;

bool is_amd(const Root& root) {
  return root.read("proc/cpuinfo").text.value_or("").find("AuthenticAMD") != std::string::npos;
}

std::string topology(const Root& root, int cpu, std::string_view what) {
  return root.read_line(fmt::format("sys/devices/system/cpu/cpu{}/topology/{}", cpu, what))
      .value_or("0");
}

// "package-0" for each CPU of the mask; with the die where a package has several.
std::map<int, std::string> package_names(const Root& root, const std::vector<int>& cpus) {
  std::map<std::string, int> dies;
  for (const int cpu : cpus) ++dies[topology(root, cpu, "physical_package_id")];
  std::map<int, std::string> names;
  for (const int cpu : cpus) {
    const std::string package = topology(root, cpu, "physical_package_id");
    names[cpu] = dies[package] > 1
                     ? fmt::format("package-{}-die-{}", package, topology(root, cpu, "die_id"))
                     : "package-" + package;
  }
  return names;
}

struct RaplEvent {
  std::string_view event;
  std::string_view domain;
  bool intel_only;
};
constexpr std::array rapl_events{
    RaplEvent{"energy-pkg", "package", false}, RaplEvent{"energy-cores", "core", true},
    RaplEvent{"energy-gpu", "uncore", true}, RaplEvent{"energy-ram", "dram", true},
    RaplEvent{"energy-psys", "psys", true}};

// The GPU that a unit is called after: "i915" is the integrated one, "xe_0000_03_00.0" says which.
std::string gpu_of_pmu(std::string_view pmu, std::string_view driver) {
  if (pmu.size() <= driver.size()) return std::string(integrated_intel_gpu);
  std::string gpu(pmu.substr(driver.size() + 1));
  std::replace(gpu.begin(), gpu.end(), '_', ':');
  return gpu;
}

bool is_pmu_of(std::string_view pmu, std::string_view driver) {
  return pmu == driver ||
         (pmu.starts_with(driver) && pmu.size() > driver.size() && pmu[driver.size()] == '_');
}

// "actual-frequency-gt1" -> "gt1"; gt0 without a suffix.
std::string gt_of(std::string_view event) {
  const size_t at = event.rfind("-gt");
  if (at == std::string_view::npos || at + 3 >= event.size()) return "gt0";
  return std::string(event.substr(at + 1));
}

std::vector<std::string> events_of(const Root& root, const std::string& pmu) {
  std::vector<std::string> events;
  for (std::string& event : root.list(fmt::format("sys/bus/event_source/devices/{}/events", pmu)))
    if (event.find('.') == std::string::npos) events.push_back(std::move(event));
  return events;
}

using NameOf = std::optional<std::pair<std::string, Quantity>> (*)(const std::string& event);

std::vector<GpuPlan> plan_gpu_pmus(const Root& root, std::string_view driver,
                                   std::string_view source, NameOf name_of, Discovery& discovery) {
  std::vector<GpuPlan> gpus;
  for (const std::string& name : list_pmus(root)) {
    if (!is_pmu_of(name, driver)) continue;
    const auto pmu = read_pmu(root, name);
    if (!pmu) continue;
    GpuPlan gpu{gpu_of_pmu(name, driver), {}};
    for (const std::string& event : events_of(root, name)) {
      auto channel = name_of(event);
      if (!channel) continue;
      auto plan = plan_event(root, *pmu, event, source, discovery);
      if (!plan) continue;
      plan->channel.name = std::move(channel->first);
      plan->channel.quantity = channel->second;
      gpu.plans.push_back(std::move(*plan));
    }
    gpus.push_back(std::move(gpu));
  }
  if (gpus.size() > 1)
    for (GpuPlan& gpu : gpus)
      for (ChannelPlan& plan : gpu.plans)
        plan.channel.name.insert(driver.size(), '@' + slug(gpu.gpu));
  return gpus;
}

std::optional<std::pair<std::string, Quantity>> i915_channel(const std::string& event) {
  for (const auto& [prefix, what, quantity] :
       {std::tuple{"actual-frequency", "actual_cycles", Quantity::frequency},
        std::tuple{"requested-frequency", "requested_cycles", Quantity::frequency},
        std::tuple{"rc6-residency", "rc6", Quantity::utilization}})
    if (event.starts_with(prefix))
      return std::pair{fmt::format("i915.pmu.{}.{}", gt_of(event), what), quantity};
  // Render and compute engines: what the frames run on.
  if ((event.starts_with("rcs") || event.starts_with("ccs")) && event.ends_with("-busy"))
    return std::pair{fmt::format("i915.pmu.{}.busy",
                                 event.substr(0, event.size() - std::string_view("-busy").size())),
                     Quantity::utilization};
  return std::nullopt;
}

std::optional<std::pair<std::string, Quantity>> xe_channel(const std::string& event) {
  if (!event.starts_with("gt-c6-residency")) return std::nullopt;
  return std::pair{std::string("xe.pmu.gt0.c6"), Quantity::utilization};
}

// Adds the counters of one more memory controller to the channel.
void add_traffic(std::vector<ChannelPlan>& plans, std::string_view channel, ChannelPlan plan) {
  const auto known = std::find_if(plans.begin(), plans.end(), [&](const ChannelPlan& other) {
    return other.channel.name == channel;
  });
  if (known == plans.end()) {
    plan.channel.name = channel;
    plan.channel.quantity = Quantity::memory_traffic;
    plans.push_back(std::move(plan));
  } else {
    known->channel.origin += " + " + plan.channel.origin;
    known->counters.insert(known->counters.end(), plan.counters.begin(), plan.counters.end());
  }
}

bool is_intel_controller(std::string_view pmu) {
  return pmu.starts_with("uncore_") && pmu.find("imc") != std::string_view::npos;
}
bool is_amd_controller(std::string_view pmu) { return is_numbered(pmu, "amd_umc_"); }

// The traffic of all memory controllers, from one of the two kinds of their counters.
std::vector<ChannelPlan> plan_controllers(const Root& root, bool free_running,
                                          Discovery& discovery) {
  struct Row {
    std::string_view event;
    std::string_view channel;
  };
  // Granite Rapids tells the two subchannels of a controller apart.
  constexpr std::array rows{Row{"cas_count_read_sch0", "uncore.imc.read"},
                            Row{"cas_count_read_sch1", "uncore.imc.read"},
                            Row{"cas_count_write_sch0", "uncore.imc.write"},
                            Row{"cas_count_write_sch1", "uncore.imc.write"},
                            Row{"data_reads", "uncore.imc.read"},
                            Row{"data_writes", "uncore.imc.write"},
                            Row{"data_read", "uncore.imc.read"},
                            Row{"data_write", "uncore.imc.write"},
                            Row{"read", "uncore.imc.read"},
                            Row{"write", "uncore.imc.write"},
                            Row{"cas_count_read", "uncore.imc.read"},
                            Row{"cas_count_write", "uncore.imc.write"},
                            Row{"gt_requests", "uncore.imc.gt"},
                            Row{"ia_requests", "uncore.imc.ia"},
                            Row{"io_requests", "uncore.imc.io"}};
  std::vector<ChannelPlan> plans;
  for (const std::string& name : list_pmus(root)) {
    if (!is_intel_controller(name) ||
        (name.find("free_running") != std::string::npos) != free_running)
      continue;
    const auto pmu = read_pmu(root, name);
    if (!pmu) continue;
    for (const Row& row : rows) {
      auto plan = plan_event(root, *pmu, row.event, "uncore", discovery);
      if (!plan) continue;
      add_traffic(plans, row.channel, std::move(*plan));
    }
  }
  return plans;
}

// The same on AMD, Zen 4 and newer. The units list no events; perf's own tables do. A command is
// for 64 bytes.
std::vector<ChannelPlan> plan_amd_controllers(const Root& root) {
  constexpr long double bytes_per_command = 64;
  std::vector<ChannelPlan> plans;
  for (const std::string& name : list_pmus(root)) {
    if (!is_amd_controller(name)) continue;
    const auto pmu = read_pmu(root, name);
    if (!pmu) continue;
    for (const auto& [channel, event] : {std::pair{"uncore.umc.read", "event=0x0a,rdwrmask=0x1"},
                                         std::pair{"uncore.umc.write", "event=0x0a,rdwrmask=0x2"}})
      if (auto plan = plan_unlisted_event(*pmu, event, Unit::byte, bytes_per_command))
        add_traffic(plans, channel, std::move(*plan));
  }
  return plans;
}

void add_gpu_counters(const Root& root, Discovery& discovery, const std::string& source,
                      std::vector<GpuPlan> gpus, const std::string& why_none) {
  if (gpus.empty()) discovery.missing.push_back({source, why_none, ""});
  for (GpuPlan& gpu : gpus)
    add_counters(root, discovery, source, counter_period_ns, std::move(gpu.plans),
                 {.gpu = gpu.gpu});
}

}  // namespace

std::vector<ChannelPlan> plan_perf_rapl(const Root& root, Discovery& discovery) {
  std::vector<ChannelPlan> plans;
  const bool amd = is_amd(root);
  if (const auto pmu = read_pmu(root, "power")) {
    const std::map<int, std::string> packages = package_names(root, pmu->cpus);
    for (const RaplEvent& event : rapl_events) {
      // AMD processors have package energy alone; kernels before 5.17 list the others, and nonsense
      // comes out.
      if (amd && event.intel_only) continue;
      const auto all = plan_event(root, *pmu, event.event, "perf_rapl", discovery);
      if (!all) continue;
      for (const CounterPlan& counter : all->counters) {
        ChannelPlan plan = *all;
        plan.counters = {counter};
        plan.channel.quantity = Quantity::energy;
        const std::string& package = packages.at(counter.cpu);
        const bool several = packages.size() > 1;
        if (event.domain == "package")
          plan.channel.name = fmt::format("rapl.{}.energy", package);
        else
          plan.channel.name = several && event.domain != "psys"
                                  ? fmt::format("rapl.{}.{}.energy", package, event.domain)
                                  : fmt::format("rapl.{}.energy", event.domain);
        plans.push_back(std::move(plan));
        if (event.domain == "psys") break;  // one platform, whatever the number of packages
      }
    }
  }
  if (const auto pmu = read_pmu(root, "power_core"))
    if (auto plan = plan_event(root, *pmu, "energy-core", "perf_rapl", discovery)) {
      plan->channel.name = "rapl.core.energy";
      plan->channel.quantity = Quantity::energy;
      plans.push_back(std::move(*plan));
    }
  return plans;
}

void discover_perf_rapl(const Root& root, Discovery& discovery) {
  std::vector<ChannelPlan> plans = plan_perf_rapl(root, discovery);
  if (plans.empty()) {
    const bool powercap = !root.list("sys/class/powercap").empty();
    discovery.missing.push_back(
        {"perf_rapl",
         powercap ? "no perf unit 'power' although powercap is there: the kernel's module is not "
                    "loaded, or does not know this processor"
                  : "no perf unit 'power': no RAPL here, or a virtual machine",
         powercap ? "sudo modprobe rapl" : ""});
    return;
  }
  add_counters(root, discovery, "perf_rapl", energy_period_ns, std::move(plans), {});
}

std::vector<ChannelPlan> plan_uncore(const Root& root, Discovery& discovery) {
  // The free-running and the programmable counters of a controller count the same bytes. On some
  // servers the former have clocks only.
  std::vector<ChannelPlan> plans = plan_controllers(root, true, discovery);
  if (plans.empty()) plans = plan_controllers(root, false, discovery);
  if (plans.empty()) plans = plan_amd_controllers(root);
  return plans;
}

void discover_uncore(const Root& root, Discovery& discovery) {
  std::vector<ChannelPlan> plans = plan_uncore(root, discovery);
  if (plans.empty()) {
    std::vector<std::string> units = list_pmus(root);
    std::erase_if(units, [](const std::string& unit) {
      return !is_intel_controller(unit) && !is_amd_controller(unit);
    });
    discovery.missing.push_back(
        {"uncore",
         units.empty() ? "no perf unit of a memory controller: usual in a virtual machine, on ARM "
                         "and on AMD before Zen 4"
                       : fmt::format("{}: no event that is known here to count traffic",
                                     fmt::join(units, ", ")),
         ""});
  }
  add_counters(root, discovery, "uncore", counter_period_ns, std::move(plans), {});
}

std::vector<GpuPlan> plan_i915_pmu(const Root& root, Discovery& discovery) {
  return plan_gpu_pmus(root, "i915", "i915_pmu", i915_channel, discovery);
}

void discover_i915_pmu(const Root& root, Discovery& discovery) {
  add_gpu_counters(root, discovery, "i915_pmu", plan_i915_pmu(root, discovery),
                   "no perf unit of the i915 driver");
}

std::vector<GpuPlan> plan_xe_pmu(const Root& root, Discovery& discovery) {
  return plan_gpu_pmus(root, "xe", "xe_pmu", xe_channel, discovery);
}

void discover_xe_pmu(const Root& root, Discovery& discovery) {
  add_gpu_counters(root, discovery, "xe_pmu", plan_xe_pmu(root, discovery),
                   "no perf unit of the xe driver; it has one from Linux 6.15 on");
}

}  // namespace energyprof::probe
