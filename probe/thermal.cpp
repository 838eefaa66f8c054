// Expects:
//
//   sys/class/thermal/thermal_zone3/{type,temp,mode}                     x86_pkg_temp, 53000,
//                                                                        enabled
//   sys/class/thermal/thermal_zone3/trip_point_0_{type,temp}             passive, 95000
//   sys/class/thermal/cooling_device0/{type,cur_state,max_state}         Processor, 0, 3
#include "probe/thermal.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <map>
#include <utility>

#include "core/clock.h"
#include "probe/devfreq.h"
#include "probe/file_source.h"
#include "probe/names.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view class_dir = "sys/class/thermal";
constexpr int64_t fast_period_ns = 100 * ns_per_ms;
constexpr int64_t acpi_period_ns = 5 * ns_per_s;  // acpitz: every read runs firmware code
constexpr size_t files_per_period = 64;

struct Device {
  std::string path;
  std::string type;  // as the kernel says
  std::string id;    // as in channel names
};

// Devices called <prefix>N, numbered within their type where it repeats.
std::vector<Device> list_devices(const Root& root, std::string_view prefix) {
  std::vector<Device> devices;
  std::map<std::string, int> type_count;
  for (const std::string& entry : root.list(class_dir)) {
    if (!is_numbered(entry, prefix)) continue;
    Device device{fmt::format("{}/{}", class_dir, entry), {}, {}};
    device.type = root.read_line(device.path + "/type").value_or(entry);
    device.id = slug(device.type);
    ++type_count[device.id];
    devices.push_back(std::move(device));
  }
  std::map<std::string, int> next;
  for (Device& device : devices)
    if (type_count[device.id] > 1) device.id += fmt::format("-{}", next[device.id]++);
  return devices;
}

bool is_disabled(const Root& root, const Device& zone) {
  return root.read_line(zone.path + "/mode") == "disabled";
}

// Where the kernel begins to slow things down: the lowest passive trip point, else the lowest hot
// or critical one. Trips that were never set are 0 or far below; of a disabled zone, none is
// heeded.
std::optional<int64_t> trip_mc(const Root& root, const Device& zone) {
  if (is_disabled(root, zone)) return std::nullopt;
  std::optional<int64_t> passive;
  std::optional<int64_t> severe;
  for (int i = 0;; ++i) {
    const auto type = root.read_line(fmt::format("{}/trip_point_{}_type", zone.path, i));
    if (!type) break;
    const auto temp =
        check_int_file(root, fmt::format("{}/trip_point_{}_temp", zone.path, i)).value;
    if (!temp || *temp <= 0 || *temp > highest_temp_mc) continue;
    if (*type == "passive") passive = std::min(passive.value_or(*temp), *temp);
    if (*type == "hot" || *type == "critical") severe = std::min(severe.value_or(*temp), *temp);
  }
  return passive ? passive : severe;
}

Channel zone_channel(const Device& zone) {
  return make_channel(fmt::format("thermal.{}.temp", zone.id), Quantity::temperature,
                      Unit::millicelsius);
}

// Why a zone is no channel; empty: it is one.
Missing explain(const Root& root, const Device& zone, const CheckedFile& temp) {
  Missing missing{"thermal", {}, {}};
  if (zone.type == "INT3400 Thermal")
    missing.reason = fmt::format("'{}' ({}) is a policy, not a sensor: its reading is a constant",
                                 temp.file.path(), shown(zone.type));
  else if (zone.type == "PMIC-Die")  // of Jetsons: 100 or 50 C for ever
    missing.reason = fmt::format("'{}' ({}) is no sensor: its reading is a constant",
                                 temp.file.path(), shown(zone.type));
  else if (!temp.problem.empty())
    missing.reason = temp.problem;
  else if (temp.value && !plausible_values(zone_channel(zone)).has(*temp.value))
    missing.reason = fmt::format("'{}' ({}) reads {} C: it is not measuring", temp.file.path(),
                                 shown(zone.type), static_cast<double>(*temp.value) / 1000.0);
  else
    return missing;
  if (is_disabled(root, zone)) {
    const std::string mode = root.display(zone.path + "/mode");
    missing.reason += "; the zone is disabled";
    missing.fix = fmt::format("echo enabled | sudo tee {}", mode);
  }
  return missing;
}

size_t discover_zones(const Root& root, Discovery& discovery) {
  const std::vector<Device> zones = list_devices(root, "thermal_zone");
  std::vector<FileChannel> quick;
  std::vector<FileChannel> acpi;
  for (const Device& zone : zones) {
    CheckedFile temp = check_int_file(root, zone.path + "/temp");
    Missing missing = explain(root, zone, temp);
    if (!missing.reason.empty()) {
      discovery.missing.push_back(std::move(missing));
      continue;
    }
    Channel channel = zone_channel(zone);
    channel.limit = trip_mc(root, zone);
    (zone.type == "acpitz" ? acpi : quick).push_back({std::move(channel), std::move(temp.file)});
  }
  add_file_source(discovery, "thermal", fast_period_ns, std::move(quick));
  add_file_source(discovery, "thermal", acpi_period_ns, std::move(acpi), {.slow = true});
  return zones.size();
}

// Cooling devices that do not slow a processor down: fans, displays, chargers and radios; and
// settings, which stay above 0 while nothing is throttled.
bool throttles(const std::string& id) {
  constexpr std::array<std::string_view, 9> others{
      "fan", "lcd", "backlight", "tcc_offset", "charger", "wifi", "wlan", "ath1", "mt7"};
  return std::none_of(others.begin(), others.end(),
                      [&](std::string_view other) { return id.find(other) != std::string::npos; });
}

// The GPU that a cooling device slows down, by the name the kernel gives it: "devfreq-<device>";
// "thermal-devfreq-0" before Linux 5.11 and "gpu-balanced" of a Jetson's kernel tell only where
// there is one device to slow down.
std::string gpu_of_cooling(const Root& root, const std::string& type) {
  constexpr std::string_view prefix = "devfreq-";
  const bool is_gpu = is_gpu_name(type);
  if (type.starts_with(prefix)) return is_gpu ? type.substr(prefix.size()) : "";
  return is_gpu || type.starts_with("thermal-devfreq-") ? only_devfreq_gpu(root) : "";
}

void discover_cooling(const Root& root, Discovery& discovery) {
  std::vector<FileChannel> rows;
  for (const Device& device : list_devices(root, "cooling_device")) {
    const CheckedFile highest = check_int_file(root, device.path + "/max_state");
    if (!throttles(device.id) || !highest.value || *highest.value <= 0) continue;
    CheckedFile state = check_int_file(root, device.path + "/cur_state");
    if (!state.problem.empty()) {
      discovery.missing.push_back({"thermal", state.problem, ""});
      continue;
    }
    Channel channel;
    channel.name = fmt::format("thermal.cooling.{}.state", device.id);
    channel.quantity = Quantity::throttle;
    channel.unit = Unit::count;
    channel.limit = highest.value;
    std::string gpu = gpu_of_cooling(root, device.type);
    if (gpu.empty()) {
      rows.push_back({std::move(channel), std::move(state.file)});
    } else {
      std::vector<FileChannel> of_gpu;
      of_gpu.push_back({std::move(channel), std::move(state.file)});
      add_file_source(discovery, "thermal", fast_period_ns, std::move(of_gpu),
                      {.gpu = std::move(gpu)});
    }
  }
  // One "Processor" for each CPU.
  const auto periods = static_cast<int64_t>(1 + rows.size() / files_per_period);
  add_file_source(discovery, "thermal", fast_period_ns * periods, std::move(rows));
}

}  // namespace

void discover_thermal(const Root& root, Discovery& discovery) {
  if (discover_zones(root, discovery) == 0)
    discovery.missing.push_back({"thermal",
                                 fmt::format("no thermal zone in '{}'; usual in a virtual machine",
                                             root.display(class_dir)),
                                 ""});
  discover_cooling(root, discovery);
}

}  // namespace energyprof::probe
