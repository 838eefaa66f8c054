#include "probe/discover.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <iterator>
#include <set>
#include <stdexcept>
#include <utility>

#include "core/clock.h"
#include "probe/amdgpu.h"
#include "probe/battery.h"
#include "probe/cgroup.h"
#include "probe/cpufreq.h"
#include "probe/devfreq.h"
#include "probe/hwmon.h"
#include "probe/i915.h"
#include "probe/machine_counters.h"
#include "probe/msr.h"
#include "probe/nvml.h"
#include "probe/perf_events.h"
#include "probe/powercap.h"
#include "probe/proc_stat.h"
#include "probe/psi.h"
#include "probe/raspberrypi.h"
#include "probe/schedstat.h"
#include "probe/thermal.h"
#include "probe/thermal_throttle.h"
#include "probe/v3d.h"
#include "probe/xe.h"

namespace energyprof::probe {
namespace {

struct Row {
  std::string_view name;
  void (*discover)(const Root&, const Selection&, Discovery&);
  bool host_only = false;  // asks the running kernel or a driver, not files below a root
  // What files below a root say that the kernel there would count.
  std::vector<ChannelPlan> (*plan)(const Root&, Discovery&) = nullptr;
};

// For sources to which it is all one how they were selected.
template <void (*discover_source)(const Root&, Discovery&)>
void plain(const Root& root, const Selection&, Discovery& discovery) {
  discover_source(root, discovery);
}

// Plans of all GPUs.
template <std::vector<GpuPlan> (*plan_gpus)(const Root&, Discovery&)>
std::vector<ChannelPlan> plan_all(const Root& root, Discovery& discovery) {
  std::vector<ChannelPlan> plans;
  for (GpuPlan& gpu : plan_gpus(root, discovery))
    std::move(gpu.plans.begin(), gpu.plans.end(), std::back_inserter(plans));
  return plans;
}

// In this order: of several ways to the same counter, the first one found is recorded.
// clang-format off
constexpr std::array rows{
    Row{"perf_rapl", plain<discover_perf_rapl>, true, plan_perf_rapl},
    Row{"powercap", plain<discover_powercap>},
    Row{"msr", discover_msr},
    Row{"i915", plain<discover_i915>},
    Row{"i915_pmu", plain<discover_i915_pmu>, true, plan_all<plan_i915_pmu>},
    Row{"xe", plain<discover_xe>},
    Row{"xe_pmu", plain<discover_xe_pmu>, true, plan_all<plan_xe_pmu>},
    Row{"amdgpu", plain<discover_amdgpu>},
    Row{"nvml", discover_nvml, true},
    Row{"hwmon", plain<discover_hwmon>},
    Row{"thermal", plain<discover_thermal>},
    Row{"cpufreq", plain<discover_cpufreq>},
    Row{"thermal_throttle", plain<discover_thermal_throttle>},
    Row{"devfreq", plain<discover_devfreq>},
    Row{"v3d", plain<discover_v3d>},
    Row{"raspberrypi", plain<discover_raspberrypi>},
    Row{"battery", plain<discover_battery>},
    Row{"proc_stat", plain<discover_proc_stat>},
    Row{"psi", plain<discover_psi>},
    Row{"cgroup", plain<discover_cgroup>},
    Row{"schedstat", discover_schedstat, true},
    Row{"perf", discover_perf_events, true},
    Row{"uncore", plain<discover_uncore>, true, plan_uncore},
};
// clang-format on

void check_names(const Selection& selection) {
  for (const std::string& name : selection.sources)
    if (std::none_of(rows.begin(), rows.end(), [&](const Row& row) { return row.name == name; }))
      throw std::runtime_error(
          fmt::format("cannot use sensor source '{}': there is none; expected {}.", name,
                      fmt::join(source_names(), ", ")));
}

bool is_selected(const Selection& selection, std::string_view name) {
  return selection.sources.empty() || std::find(selection.sources.begin(), selection.sources.end(),
                                                name) != selection.sources.end();
}

// Sources name their channels uniquely; a machine that lists one thing twice gets "#2" here.
void number_channels(Discovery& discovery) {
  std::set<std::string> taken;
  int32_t id = 0;
  for (const auto& source : discovery.sources)
    for (Channel& channel : source->channels()) {
      channel.id = ++id;
      const std::string name = channel.name;
      for (int copy = 2; !taken.insert(channel.name).second; ++copy)
        channel.name = fmt::format("{}#{}", name, copy);
    }
}

// The first three, then how many more.
std::string first_of(std::vector<std::string> names) {
  constexpr size_t shown = 3;
  const size_t more = names.size() > shown ? names.size() - shown : 0;
  names.resize(names.size() - more);
  std::string text = fmt::format("{}", fmt::join(names, ", "));
  if (more > 0) text += fmt::format(" and {} more", more);
  return text;
}

// Why a source that asks the running kernel tells nothing of what lies below a root.
Missing not_below_a_root(const Row& row, const Root& root) {
  Missing missing{std::string(row.name), "not under --root: not read from files", ""};
  if (row.plan == nullptr) return missing;
  Discovery discovery;
  std::vector<std::string> names;
  for (ChannelPlan& plan : row.plan(root, discovery)) names.push_back(std::move(plan.channel.name));
  if (!names.empty())
    missing.reason +=
        fmt::format("; on that machine perf may count {}", first_of(std::move(names)));
  return missing;
}

// Directories that sources look into: without permission they find nothing there.
void report_forbidden(const Root& root, const Selection& selection, Discovery& discovery) {
  constexpr std::array<std::pair<std::string_view, std::string_view>, 7> directories{
      {{"powercap", "sys/class/powercap"},
       {"hwmon", "sys/class/hwmon"},
       {"thermal", "sys/class/thermal"},
       {"cpufreq", "sys/devices/system/cpu"},
       {"devfreq", "sys/class/devfreq"},
       {"battery", "sys/class/power_supply"},
       {"amdgpu", "sys/class/drm"}}};
  for (const auto& [source, path] : directories)
    if (is_selected(selection, source) && root.list_error(path) == EACCES)
      discovery.missing.push_back(
          {std::string(source),
           fmt::format("cannot list '{}': {}", root.display(path), errno_text(EACCES)),
           "sudo chmod a+rx " + root.display(path)});
}

// A command that changes no file below the root would change the machine that runs, not the one
// that the files are of.
void withdraw_fix(Missing& missing, const Root& root) {
  if (missing.fix.empty() || missing.fix.find(root.directory()) != std::string::npos) return;
  missing.reason += fmt::format("; on that machine: {}", missing.fix);
  missing.fix.clear();
}

// Names of the channels that `wanted` picks.
template <class Predicate>
std::string names_where(const Discovery& discovery, Predicate wanted) {
  std::vector<std::string> names;
  for (const auto& source : discovery.sources)
    for (const Channel& channel : source->channels())
      if (wanted(channel)) names.push_back(channel.name);
  return first_of(std::move(names));
}

// A question a study may ask, and the channels that answer it.
struct Question {
  std::string_view text;
  bool (*answers)(const Channel&);
};
bool is_gpu(const Channel& channel) { return !channel.gpu.empty(); }
// Cooling by devfreq slows a GPU or the memory down, and not always says which.
bool is_package(const Channel& channel) {
  return !is_gpu(channel) && channel.name.find("devfreq") == std::string::npos;
}
bool is_watts(const Channel& channel) { return unit_info(channel.unit).si == "W"; }

// clang-format off
constexpr std::array questions{
    Question{"energy", [](const Channel& c) { return c.quantity == Quantity::energy && c.kind == Kind::cumulative && !c.stands_still; }},
    Question{"GPU energy", [](const Channel& c) { return c.quantity == Quantity::energy && !c.stands_still && (is_gpu(c) || c.name.find("uncore") != std::string::npos); }},
    Question{"power", [](const Channel& c) { return c.quantity == Quantity::power; }},
    Question{"GPU clock", [](const Channel& c) { return c.quantity == Quantity::frequency && is_gpu(c); }},
    Question{"CPU clock", [](const Channel& c) { return c.quantity == Quantity::frequency && !is_gpu(c); }},
    Question{"temperature", [](const Channel& c) { return c.quantity == Quantity::temperature; }},
    Question{"GPU throttling", [](const Channel& c) { return c.quantity == Quantity::throttle && is_gpu(c); }},
    Question{"throttling of the package", [](const Channel& c) { return c.quantity == Quantity::throttle && is_package(c); }},
    Question{"power limits", [](const Channel& c) { return c.quantity == Quantity::limit && is_watts(c); }},
    Question{"cache misses", [](const Channel& c) { return c.quantity == Quantity::cache_miss; }},
    Question{"memory traffic", [](const Channel& c) { return c.quantity == Quantity::memory_traffic; }},
    Question{"interference by the host", [](const Channel& c) { return c.quantity == Quantity::interference; }},
};
// clang-format on

}  // namespace

std::vector<std::string> source_names() {
  std::vector<std::string> names;
  for (const Row& row : rows) names.emplace_back(row.name);
  return names;
}

Discovery discover(const Root& root, const Selection& selection) {
  check_names(selection);
  Discovery discovery;
  for (const Row& row : rows) {
    if (!is_selected(selection, row.name)) continue;
    if (row.host_only && !root.is_host())
      discovery.missing.push_back(not_below_a_root(row, root));
    else
      row.discover(root, selection, discovery);
  }
  report_forbidden(root, selection, discovery);
  if (!root.is_host())
    for (Missing& missing : discovery.missing) withdraw_fix(missing, root);
  number_channels(discovery);
  return discovery;
}

std::string verdict(const Discovery& discovery) {
  std::vector<std::string> can;
  std::vector<std::string_view> cannot;
  for (const Question& question : questions) {
    const std::string names = names_where(discovery, question.answers);
    if (names.empty())
      cannot.push_back(question.text);
    else
      can.push_back(fmt::format("{} ({})", question.text, names));
  }
  const auto lacks = [&](std::string_view text) {
    return std::find(cannot.begin(), cannot.end(), text) != cannot.end();
  };
  std::string line = can.empty() ? "Nothing but frame times can be measured here"
                                 : fmt::format("Can be measured here: {}", fmt::join(can, "; "));
  // Energy over time is power.
  if (!lacks("energy")) std::erase(cannot, "power");
  if (!cannot.empty()) line += fmt::format(". Cannot: {}", fmt::join(cannot, ", "));
  if (lacks("energy") && lacks("power"))
    line += ". A study ranks by time only; joules per ray will be refused";
  else if (lacks("energy"))
    line += ". Joules come from sampled power: long windows only";
  if (lacks("GPU throttling") && lacks("GPU clock"))
    line += ". Slow frames cannot be blamed on GPU throttling: they are the host's or unexplained";
  else if (lacks("GPU throttling"))
    line += ". GPU throttling can only be inferred from its clock";
  if (lacks("cache misses") && lacks("memory traffic"))
    line += ". Cache misses are modelled, not measured";
  return line + '.';
}

}  // namespace energyprof::probe
