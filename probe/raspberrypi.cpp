// Expects one of:
//
//   sys/devices/platform/soc/soc:firmware/get_throttled     50005, hexadecimal without 0x
//   sys/class/hwmon/hwmon1/{name,in0_lcrit_alarm}           rpi_volt, 1
#include "probe/raspberrypi.h"

#include <fmt/format.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <utility>

#include "core/clock.h"
#include "probe/file_source.h"
#include "probe/names.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view platform_dir = "sys/devices/platform";
constexpr std::string_view hwmon_dir = "sys/class/hwmon";
constexpr int64_t poll_period_ns = 100 * ns_per_ms;

struct Bit {
  int number;  // now; 16 higher: since boot
  std::string_view name;
};
constexpr std::array bits{Bit{0, "undervoltage"}, Bit{1, "freq_capped"}, Bit{2, "throttled"},
                          Bit{3, "soft_temp_limit"}};

std::optional<int64_t> parse_word(std::string_view text) {
  text = trim(text);
  for (const std::string_view prefix : {"throttled=", "0x"})
    if (text.starts_with(prefix)) text.remove_prefix(prefix.size());
  uint32_t word = 0;
  const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), word, 16);
  if (error != std::errc{} || stop != text.data() + text.size()) return std::nullopt;
  return word;
}

Channel flag(std::string name, Quantity quantity, std::string origin) {
  return make_channel(std::move(name), quantity, Unit::count, Kind::flag, std::move(origin));
}

std::vector<Channel> word_channels(const std::string& path) {
  std::vector<Channel> channels;
  for (const Bit& bit : bits)
    channels.push_back(flag(fmt::format("rpi.throttle.{}", bit.name), Quantity::throttle,
                            fmt::format("{}: bit {}", path, bit.number)));
  for (const Bit& bit : bits)
    channels.push_back(flag(fmt::format("rpi.since_boot.{}", bit.name), Quantity::utilization,
                            fmt::format("{}: bit {}", path, bit.number + 16)));
  return channels;
}

// A firmware call for each read.
class WordSource final : public SensorSource {
 public:
  explicit WordSource(TextFile file)
      : SensorSource("raspberrypi", poll_period_ns, word_channels(file.path()),
                     SourceTraits{.slow = true}),
        file_(std::move(file)) {}

  void poll(std::span<Reading> out) noexcept override {
    std::array<char, 64> buffer;
    const TextFile::Read read = file_.read(buffer);
    const std::optional<int64_t> word = read.error == 0 ? parse_word(read.text) : std::nullopt;
    for (size_t i = 0; i < bits.size(); ++i) {
      out[i] = read.reading(word ? std::optional((*word >> bits[i].number) & 1) : std::nullopt);
      out[bits.size() + i] =
          read.reading(word ? std::optional((*word >> (bits[i].number + 16)) & 1) : std::nullopt);
    }
  }

 private:
  TextFile file_;
};

// The firmware's device: on the platform bus or one level below it.
std::optional<std::string> find_word(const Root& root) {
  const auto find_in = [&](const std::string& parent) -> std::optional<std::string> {
    for (const std::string& entry : root.list(parent)) {
      std::string path = fmt::format("{}/{}/get_throttled", parent, entry);
      if (entry.find("firmware") != std::string::npos && root.exists(path)) return path;
    }
    return std::nullopt;
  };
  if (auto path = find_in(std::string(platform_dir))) return path;
  for (const std::string& entry : root.list(platform_dir))
    if (entry.starts_with("soc"))
      if (auto path = find_in(fmt::format("{}/{}", platform_dir, entry))) return path;
  return std::nullopt;
}

std::optional<std::string> find_voltage_alarm(const Root& root) {
  for (const std::string& entry : root.list(hwmon_dir)) {
    const std::string chip = fmt::format("{}/{}", hwmon_dir, entry);
    if (root.read_line(chip + "/name") == "rpi_volt") return chip + "/in0_lcrit_alarm";
  }
  return std::nullopt;
}

}  // namespace

void discover_raspberrypi(const Root& root, Discovery& discovery) {
  const std::optional<std::string> word_path = find_word(root);
  if (word_path) {
    const Root::Text text = root.read(*word_path);
    if (is_transient(text.error) || (text.text && parse_word(*text.text))) {
      discovery.sources.push_back(std::make_unique<WordSource>(TextFile(root, *word_path)));
      return;
    }
    discovery.missing.push_back(
        {"raspberrypi",
         text.text ? fmt::format("'{}' holds no hexadecimal number", root.display(*word_path))
                   : fmt::format("cannot read '{}': {}", root.display(*word_path),
                                 errno_text(text.error)),
         ""});
  }
  const std::optional<std::string> alarm_path = find_voltage_alarm(root);
  if (!alarm_path) {
    if (!word_path) discovery.missing.push_back({"raspberrypi", "no Raspberry Pi firmware", ""});
    return;
  }
  CheckedFile alarm = check_int_file(root, *alarm_path);
  if (!alarm.problem.empty()) {
    discovery.missing.push_back({"raspberrypi", alarm.problem, ""});
    return;
  }
  std::vector<FileChannel> rows;
  rows.push_back(
      {flag("rpi.throttle.undervoltage", Quantity::throttle, {}), std::move(alarm.file)});
  add_file_source(discovery, "raspberrypi", poll_period_ns, std::move(rows));
}

}  // namespace energyprof::probe
