// Expects, for each CPU:
//
//   sys/devices/system/cpu/cpu0/thermal_throttle/package_throttle_count           12627
//   sys/devices/system/cpu/cpu0/thermal_throttle/package_throttle_total_time_ms   50751
//   sys/devices/system/cpu/cpu0/thermal_throttle/core_throttle_{count,total_time_ms}
//   sys/devices/system/cpu/cpu0/topology/physical_package_id                      0
#include "probe/thermal_throttle.h"

#include <fmt/format.h>

#include <cerrno>
#include <map>
#include <utility>

#include "core/clock.h"
#include "probe/file_source.h"
#include "probe/names.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view cpu_dir = "sys/devices/system/cpu";
constexpr int64_t poll_period_ns = 100 * ns_per_ms;
constexpr size_t files_per_period = 128;  // about 0.1 ms: of 32 CPUs

// The files that mirror one counter, by the name of its channel.
using Mirrors = std::map<std::string, std::vector<TextFile>>;

}  // namespace

void discover_thermal_throttle(const Root& root, Discovery& discovery) {
  Mirrors mirrors;
  std::string problem;
  size_t problem_count = 0;
  for (const std::string& entry : root.list(cpu_dir)) {
    if (!is_numbered(entry, "cpu")) continue;
    const std::string cpu = fmt::format("{}/{}", cpu_dir, entry);
    const std::string package =
        fmt::format("cpu.package-{}",
                    check_int_file(root, cpu + "/topology/physical_package_id").value.value_or(0));
    for (const auto& [scope, owner] :
         {std::pair{"package", package}, std::pair{"core", std::string("cpu.core")}})
      for (const auto& [file, what] :
           {std::pair{"count", "count"}, std::pair{"total_time_ms", "time"}}) {
        CheckedFile counter = check_int_file(
            root, fmt::format("{}/thermal_throttle/{}_throttle_{}", cpu, scope, file));
        if (counter.problem.empty()) {
          mirrors[fmt::format("{}.throttle.{}", owner, what)].push_back(std::move(counter.file));
        } else if (counter.error != ENOENT && problem_count++ == 0) {
          problem = std::move(counter.problem);
        }
      }
  }
  if (problem_count > 1) problem += fmt::format(", and {} more like it", problem_count - 1);
  if (problem_count > 0) discovery.missing.push_back({"thermal_throttle", problem, ""});
  if (mirrors.empty()) {
    if (problem_count > 0) return;
    discovery.missing.push_back(
        {"thermal_throttle",
         fmt::format(
             "no thermal_throttle counters in '{}': only Intel processors have them, and no "
             "virtual machine",
             root.display(cpu_dir)),
         ""});
    return;
  }
  std::vector<Channel> channels;
  FileGroupSource::FileGroups groups;
  size_t file_count = 0;
  for (auto& [name, files] : mirrors) {
    Channel channel;
    channel.name = name;
    channel.quantity = Quantity::throttle;
    channel.unit = name.ends_with("time") ? Unit::millisecond : Unit::count;
    channel.kind = Kind::cumulative;
    channel.origin = files.size() == 1 ? files.front().path()
                                       : fmt::format("highest of {} and {} more",
                                                     files.front().path(), files.size() - 1);
    channels.push_back(std::move(channel));
    file_count += files.size();
    groups.push_back(std::move(files));
  }
  const auto periods = static_cast<int64_t>(1 + file_count / files_per_period);
  discovery.sources.push_back(std::make_unique<FileGroupSource>(
      "thermal_throttle", poll_period_ns * periods, std::move(channels), std::move(groups),
      Pick::highest, SourceTraits{.slow = true}));
}

}  // namespace energyprof::probe
