// Expects, for each CPU:
//
//   sys/devices/system/cpu/cpu0/thermal_throttle/package_throttle_count           12627
//   sys/devices/system/cpu/cpu0/thermal_throttle/package_throttle_total_time_ms   50751
//   sys/devices/system/cpu/cpu0/thermal_throttle/core_throttle_{count,total_time_ms}
//   sys/devices/system/cpu/cpu0/topology/{physical_package_id,core_id}            0, 0
#include "probe/thermal_throttle.h"

#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <map>
#include <utility>

#include "core/clock.h"
#include "probe/names.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view cpu_dir = "sys/devices/system/cpu";
constexpr int64_t poll_period_ns = 100 * ns_per_ms;
constexpr size_t files_per_period = 128;  // about 0.1 ms: of 32 CPUs

// A counter that the files of several CPUs repeat, and the highest that any of them said.
struct Counter {
  std::vector<TextFile> mirrors;
  int64_t highest = 0;
};
// The counters of a channel, which is their sum, by what they belong to: "0" (a package), "0.4" (a
// core of it).
using Counters = std::map<std::string, Counter>;

class ThrottleSource final : public SensorSource {
 public:
  ThrottleSource(int64_t period_ns, std::vector<Channel> channels, std::vector<Counters> counters)
      : SensorSource("thermal_throttle", period_ns, std::move(channels),
                     SourceTraits{.slow = true}),
        counters_(std::move(counters)) {}

  void poll(std::span<Reading> out) noexcept override {
    for (size_t i = 0; i < counters_.size(); ++i) out[i] = read(counters_[i]);
  }

 private:
  static Reading read(Counters& counters) noexcept {
    Reading sum{.status = PollStatus::gone};
    const int64_t before_ns = now_ns();
    for (auto& [owner, counter] : counters) {
      for (TextFile& file : counter.mirrors) {
        const Reading reading = file.read_int();
        if (reading.status == PollStatus::ok)
          counter.highest = std::max(counter.highest, reading.value);
        if (reading.status < sum.status) {  // ok < retry < gone
          sum.status = reading.status;
          sum.error = reading.error;
        }
      }
      sum.value += counter.highest;
    }
    sum.width_ns = now_ns() - before_ns;
    sum.t_ns = before_ns + sum.width_ns / 2;
    return sum;
  }

  std::vector<Counters> counters_;
};

}  // namespace

void discover_thermal_throttle(const Root& root, Discovery& discovery) {
  std::map<std::string, Counters> by_channel;
  std::string problem;
  size_t problem_count = 0;
  for (const std::string& entry : root.list(cpu_dir)) {
    if (!is_numbered(entry, "cpu")) continue;
    const std::string cpu = fmt::format("{}/{}", cpu_dir, entry);
    const std::string package = root.read_line(cpu + "/topology/physical_package_id").value_or("0");
    // Without topology every CPU is a core of its own.
    const std::string core =
        fmt::format("{}.{}", package, root.read_line(cpu + "/topology/core_id").value_or(entry));
    struct Scope {
      std::string_view name;
      std::string channel;
      const std::string& owner;
    };
    for (const Scope& scope :
         {Scope{"package", fmt::format("cpu.package-{}", slug(package)), package},
          Scope{"core", "cpu.core", core}})
      for (const auto& [file, what] :
           {std::pair{"count", "count"}, std::pair{"total_time_ms", "time"}}) {
        CheckedFile checked = check_int_file(
            root, fmt::format("{}/thermal_throttle/{}_throttle_{}", cpu, scope.name, file));
        if (checked.problem.empty()) {
          Counter& counter =
              by_channel[fmt::format("{}.throttle.{}", scope.channel, what)][scope.owner];
          counter.mirrors.push_back(std::move(checked.file));
          counter.highest = std::max(counter.highest, checked.value.value_or(0));
        } else if (checked.error != ENOENT && problem_count++ == 0) {
          problem = std::move(checked.problem);
        }
      }
  }
  if (problem_count > 1) problem += fmt::format(", and {} more like it", problem_count - 1);
  if (problem_count > 0) discovery.missing.push_back({"thermal_throttle", problem, ""});
  if (by_channel.empty()) {
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
  std::vector<Counters> all;
  size_t file_count = 0;
  for (auto& [name, counters] : by_channel) {
    Channel channel;
    channel.name = name;
    channel.quantity = Quantity::throttle;
    channel.unit = name.ends_with("time") ? Unit::millisecond : Unit::count;
    channel.kind = Kind::cumulative;
    size_t mirror_count = 0;
    for (const auto& [owner, counter] : counters) mirror_count += counter.mirrors.size();
    const std::string& first = counters.begin()->second.mirrors.front().path();
    if (mirror_count == 1)
      channel.origin = first;
    else if (counters.size() == 1)
      channel.origin = fmt::format("highest of {} and {} more", first, mirror_count - 1);
    else
      channel.origin = fmt::format("sum over {} cores of {} and {} more", counters.size(), first,
                                   mirror_count - 1);
    channels.push_back(std::move(channel));
    file_count += mirror_count;
    all.push_back(std::move(counters));
  }
  const auto periods = static_cast<int64_t>(1 + file_count / files_per_period);
  discovery.sources.push_back(std::make_unique<ThrottleSource>(
      poll_period_ns * periods, std::move(channels), std::move(all)));
}

}  // namespace energyprof::probe
