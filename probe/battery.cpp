// Expects:
//
//   sys/class/power_supply/BAT0/{type,status}                  Battery, Discharging
//   sys/class/power_supply/BAT0/power_now                      4830000, uW; or both of
//   sys/class/power_supply/BAT0/{current_now,voltage_now}      uA, uV
#include "probe/battery.h"

#include <fmt/format.h>

#include <array>
#include <limits>
#include <utility>

#include "core/clock.h"
#include "probe/names.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view class_dir = "sys/class/power_supply";
constexpr int64_t poll_period_ns = 2 * ns_per_s;

// uA x uV / 1e6 = uW. The current is negative while discharging on some boards.
std::optional<int64_t> power_uw(int64_t current_ua, int64_t voltage_uv) {
  const __int128 product = static_cast<__int128>(current_ua) * voltage_uv / 1'000'000;
  const __int128 power = product < 0 ? -product : product;
  if (power > std::numeric_limits<int64_t>::max()) return std::nullopt;
  return static_cast<int64_t>(power);
}

class BatterySource final : public SensorSource {
 public:
  struct Files {
    TextFile status;
    std::optional<TextFile> power_uw;
    std::optional<TextFile> current_ua;
    std::optional<TextFile> voltage_uv;
  };
  BatterySource(Channel channel, Files files)
      : SensorSource("battery", poll_period_ns, {std::move(channel)}, SourceTraits{.slow = true}),
        files_(std::move(files)) {}

  void poll(std::span<Reading> out) noexcept override {
    std::array<char, 64> buffer;
    const TextFile::Read status = files_.status.read(buffer);
    if (!status.text.starts_with("Discharging")) {
      out[0] = status.reading(std::nullopt);
      return;
    }
    if (files_.power_uw) {
      out[0] = files_.power_uw->read_int();
      if (out[0].value < 0) out[0].value = -out[0].value;
      return;
    }
    out[0] = files_.current_ua->read_int();
    const Reading voltage = files_.voltage_uv->read_int();
    if (out[0].status != PollStatus::ok) return;
    const std::optional<int64_t> power = power_uw(out[0].value, voltage.value);
    if (voltage.status != PollStatus::ok || !power)
      out[0].status = std::max(voltage.status, PollStatus::retry);
    else
      out[0].value = *power;
  }

 private:
  Files files_;
};

void discover_one(const Root& root, const std::string& entry, Discovery& discovery) {
  const std::string supply = fmt::format("{}/{}", class_dir, entry);
  BatterySource::Files files{TextFile(root, supply + "/status"), {}, {}, {}};
  CheckedFile power = check_int_file(root, supply + "/power_now");
  CheckedFile current = check_int_file(root, supply + "/current_now");
  CheckedFile voltage = check_int_file(root, supply + "/voltage_now");
  Channel channel;
  channel.name = fmt::format("battery.{}.power", slug(entry));
  channel.quantity = Quantity::power;
  channel.unit = Unit::microwatt;
  channel.kind = Kind::average;
  if (power.problem.empty()) {
    channel.origin = power.file.path();
    files.power_uw.emplace(std::move(power.file));
  } else if (current.problem.empty() && voltage.problem.empty()) {
    channel.origin = fmt::format("{} x voltage_now", current.file.path());
    files.current_ua.emplace(std::move(current.file));
    files.voltage_uv.emplace(std::move(voltage.file));
  } else {
    discovery.missing.push_back(
        {"battery",
         fmt::format("'{}' tells neither power nor current and voltage", root.display(supply)),
         ""});
    return;
  }
  const std::string status = root.read_line(supply + "/status").value_or("unknown");
  if (status != "Discharging")
    discovery.missing.push_back({"battery",
                                 fmt::format("'{}' is {}: its power says something only while it "
                                             "discharges",
                                             entry, status),
                                 "unplug the power supply"});
  discovery.sources.push_back(
      std::make_unique<BatterySource>(std::move(channel), std::move(files)));
}

}  // namespace

void discover_battery(const Root& root, Discovery& discovery) {
  bool found = false;
  for (const std::string& entry : root.list(class_dir)) {
    const std::string supply = fmt::format("{}/{}", class_dir, entry);
    // Batteries of mice and pens are no power supply of this machine.
    if (root.read_line(supply + "/type") != "Battery" ||
        root.read_line(supply + "/scope") == "Device")
      continue;
    found = true;
    discover_one(root, entry, discovery);
  }
  if (!found) discovery.missing.push_back({"battery", "no battery", ""});
}

}  // namespace energyprof::probe
