// Expects:
//
//   sys/class/power_supply/BAT0/{type,status}                  Battery, Discharging
//   sys/class/power_supply/BAT0/power_now                      4830000, uW; or both of
//   sys/class/power_supply/BAT0/{current_now,voltage_now}      uA, uV
//   sys/class/power_supply/BAT0/energy_now                     49450000, uWh
#include "probe/battery.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <limits>
#include <utility>

#include "core/clock.h"
#include "probe/names.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view class_dir = "sys/class/power_supply";
constexpr int64_t poll_period_ns = 2 * ns_per_s;

constexpr int64_t uj_per_uwh = 3600;

// Absolute value: the current, and with it the power, is negative while discharging on some boards.
std::optional<int64_t> magnitude(__int128 value) {
  if (value < 0) value = -value;
  if (value > std::numeric_limits<int64_t>::max()) return std::nullopt;
  return static_cast<int64_t>(value);
}

// uA x uV / 1e6 = uW.
std::optional<int64_t> power_uw(int64_t current_ua, int64_t voltage_uv) {
  return magnitude(static_cast<__int128>(current_ua) * voltage_uv / 1'000'000);
}

// `reading` with another value; `retry` where there is none.
Reading with_value(Reading reading, std::optional<int64_t> value) {
  if (reading.status != PollStatus::ok) return reading;
  reading.value = value.value_or(0);
  if (!value) reading.status = PollStatus::retry;
  return reading;
}

class BatterySource final : public SensorSource {
 public:
  // Power comes from one file or from two; it or the energy may be lacking.
  struct Files {
    TextFile status;
    std::optional<TextFile> power_uw;
    std::optional<TextFile> current_ua;
    std::optional<TextFile> voltage_uv;
    std::optional<TextFile> energy_uwh;
  };
  BatterySource(std::vector<Channel> channels, Files files)
      : SensorSource("battery", poll_period_ns, std::move(channels), SourceTraits{.slow = true}),
        files_(std::move(files)) {}

  void poll(std::span<Reading> out) noexcept override {
    std::array<char, 64> buffer;
    const TextFile::Read status = files_.status.read(buffer);
    if (!status.text.starts_with("Discharging")) {
      for (Reading& reading : out) reading = status.reading(std::nullopt);
      return;
    }
    size_t next = 0;
    if (files_.power_uw) {
      const Reading power = files_.power_uw->read_int();
      out[next++] = with_value(power, magnitude(power.value));
    } else if (files_.current_ua) {
      out[next++] = read_product();
    }
    if (!files_.energy_uwh) return;
    const Reading energy = files_.energy_uwh->read_int();
    out[next] = with_value(energy, energy_uj(energy.value));
  }

 private:
  Reading read_product() noexcept {
    const Reading current = files_.current_ua->read_int();
    const Reading voltage = files_.voltage_uv->read_int();
    Reading power;
    power.status = std::max(current.status, voltage.status);  // ok < retry < gone
    power.t_ns = current.t_ns + (voltage.t_ns - current.t_ns) / 2;
    power.width_ns = voltage.t_ns - current.t_ns + (current.width_ns + voltage.width_ns) / 2;
    power.error = current.error != 0 ? current.error : voltage.error;
    return with_value(power, power_uw(current.value, voltage.value));
  }

  static std::optional<int64_t> energy_uj(int64_t energy_uwh) {
    int64_t energy_uj = 0;
    if (__builtin_mul_overflow(energy_uwh, uj_per_uwh, &energy_uj)) return std::nullopt;
    return energy_uj;
  }

  Files files_;
};

void discover_one(const Root& root, const std::string& entry, Discovery& discovery) {
  const std::string supply = fmt::format("{}/{}", class_dir, entry);
  const Root::Text status = root.read(supply + "/status");
  if (!status.text && !is_transient(status.error)) {
    discovery.missing.push_back(
        {"battery",
         fmt::format("cannot tell whether '{}' discharges: cannot read '{}/status': {}", entry,
                     root.display(supply), errno_text(status.error)),
         ""});
    return;
  }
  BatterySource::Files files{TextFile(root, supply + "/status"), {}, {}, {}, {}};
  // ENODEV of a rate: the battery does not know it now, as at times after a change of the supply.
  CheckedFile power = check_int_file(root, supply + "/power_now", ENODEV);
  CheckedFile current = check_int_file(root, supply + "/current_now", ENODEV);
  CheckedFile voltage = check_int_file(root, supply + "/voltage_now");
  CheckedFile energy = check_int_file(root, supply + "/energy_now");
  std::vector<Channel> channels;
  const auto add = [&](const char* what, Quantity quantity, Unit unit, Kind kind,
                       std::string origin) {
    Channel channel;
    channel.name = fmt::format("battery.{}.{}", slug(entry), what);
    channel.quantity = quantity;
    channel.unit = unit;
    channel.kind = kind;
    channel.origin = std::move(origin);
    channels.push_back(std::move(channel));
  };
  const auto is_use = [&](const CheckedFile& file) {
    if (file.error != ENODATA) return file.problem.empty();
    discovery.missing.push_back(
        {"battery", fmt::format("'{}' says that it is unknown now", file.file.path()), ""});
    return true;
  };
  const bool has_product = current.problem.empty() && voltage.problem.empty();
  if (power.problem.empty() || (!has_product && is_use(power))) {
    add("power", Quantity::power, Unit::microwatt, Kind::average, power.file.path());
    files.power_uw.emplace(std::move(power.file));
  } else if (voltage.problem.empty() && is_use(current)) {
    add("power", Quantity::power, Unit::microwatt, Kind::average,
        fmt::format("{} x voltage_now", current.file.path()));
    files.current_ua.emplace(std::move(current.file));
    files.voltage_uv.emplace(std::move(voltage.file));
  } else {
    discovery.missing.push_back(
        {"battery",
         fmt::format("'{}' tells neither power nor current and voltage", root.display(supply)),
         ""});
  }
  if (energy.problem.empty()) {
    add("energy", Quantity::energy, Unit::microjoule, Kind::gauge,
        fmt::format("{} x 3600", energy.file.path()));
    files.energy_uwh.emplace(std::move(energy.file));
  }
  if (channels.empty()) return;
  const std::string now = root.read_line(supply + "/status").value_or("unknown");
  if (now != "Discharging")
    discovery.missing.push_back(
        {"battery",
         fmt::format("'{}' is {}: it tells something only while it discharges, without the power "
                     "supply",
                     entry, now),
         ""});
  discovery.sources.push_back(
      std::make_unique<BatterySource>(std::move(channels), std::move(files)));
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
