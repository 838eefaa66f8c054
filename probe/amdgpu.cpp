// Expects:
//
//   sys/class/drm/card1/device/gpu_metrics           binary, see gpu_metrics.cpp
//   sys/class/drm/card1/device/gpu_busy_percent      79
//   sys/class/drm/card1/device/pp_dpm_sclk           0: 800Mhz *
//                                                    1: 1100Mhz
//   sys/class/drm/card1/device/power/control         on: never suspended; auto: when idle
//   sys/class/drm/card1/device/uevent                PCI_ID=1002:15BF
//   sys/class/drm/card1/device/hwmon/hwmon6/...      power1_input (uW), power1_cap (uW),
//                                                    temp1_label (edge), temp1_crit (mC)
#include "probe/amdgpu.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <set>
#include <thread>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/file_source.h"
#include "probe/gpu_metrics.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

// The driver asks the firmware for the table at most once per millisecond, and the table holds
// averages over about as long; reading it 100 times a second is the budget.
constexpr int64_t metrics_period_ns = 10 * ns_per_ms;
// Each of these files costs a message to the firmware on older GPUs.
constexpr int64_t file_period_ns = 50 * ns_per_ms;

constexpr size_t page_size = 4096;  // the most that a file of sysfs gives at once
using Page = std::array<char, page_size>;

// A card, and what is found out about it once.
struct Card {
  const Root& root;
  std::string prefix;   // "amdgpu"
  std::string device;   // "sys/class/drm/card1/device"
  uint32_t pci_device;  // 0: unknown
  SourceTraits traits;
  Discovery& discovery;

  [[nodiscard]] std::optional<int64_t> read_int(std::string_view file) const {
    const std::optional<std::string> line = root.read_line(fmt::format("{}/{}", device, file));
    return line ? parse_int(*line) : std::nullopt;
  }
  void miss(std::string reason, std::string fix = {}) const {
    discovery.missing.push_back({"amdgpu", std::move(reason), std::move(fix)});
  }
};

std::optional<uint32_t> parse_hex(std::string_view text) {
  uint32_t value = 0;
  const char* const end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, value, 16);
  if (error != std::errc{} || stop != end) return std::nullopt;
  return value;
}

// 0x15bf of "PCI_ID=1002:15BF", or of the file that says the same.
uint32_t pci_device_of(const Root& root, const std::string& device) {
  const std::string id = root.read_line(device + "/device").value_or("");
  if (id.starts_with("0x"))
    if (const auto value = parse_hex(std::string_view(id).substr(2))) return *value;
  const std::string uevent = root.read(device + "/uevent").text.value_or("");
  constexpr std::string_view key = "PCI_ID=1002:";
  const size_t at = uevent.find(key);
  if (at == std::string::npos) return 0;
  return parse_hex(std::string_view(uevent).substr(at + key.size(), 4)).value_or(0);
}

// What a file pp_dpm_* says.
struct Levels {
  std::optional<int64_t> current_mhz;
  std::optional<int64_t> highest_mhz;
};

// Lines "1: 1100Mhz *", where * marks the current level. "S: 19Mhz *" is sleep, "1: 0Mhz *" a clock
// that stands still. No current level if several different ones are marked.
Levels parse_levels(std::string_view text) noexcept {
  Levels levels;
  bool is_ambiguous = false;
  while (!text.empty()) {
    const size_t end = std::min(text.find('\n'), text.size());
    std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    const size_t colon = line.find(": ");
    if (colon == std::string_view::npos) continue;
    line.remove_prefix(colon + 2);
    int64_t mhz = 0;
    const auto [stop, error] = std::from_chars(line.data(), line.data() + line.size(), mhz);
    if (error != std::errc{} || mhz < 0) continue;
    line.remove_prefix(static_cast<size_t>(stop - line.data()));
    if (!line.starts_with("Mhz") && !line.starts_with("MHz")) continue;
    levels.highest_mhz = std::max(levels.highest_mhz.value_or(0), mhz);
    if (line.find('*') == std::string_view::npos) continue;
    is_ambiguous = is_ambiguous || (levels.current_mhz && *levels.current_mhz != mhz);
    levels.current_mhz = mhz;
  }
  if (is_ambiguous) levels.current_mhz.reset();
  return levels;
}

// A clock, and the file that lists its levels.
struct Clock {
  std::string_view name;
  std::string_view file;
};
constexpr std::array clocks{Clock{"gfx_freq", "pp_dpm_sclk"}, Clock{"mem_freq", "pp_dpm_mclk"},
                            Clock{"soc_freq", "pp_dpm_socclk"}, Clock{"fclk_freq", "pp_dpm_fclk"}};

// The card's files in hwmon that are wanted here.
struct HwmonFacts {
  std::optional<int64_t> power_uw;
  std::optional<int64_t> power_cap_uw;
  std::optional<int64_t> edge_crit_mc, hotspot_crit_mc, mem_crit_mc;
};

HwmonFacts read_hwmon(const Card& card) {
  HwmonFacts facts;
  for (const std::string& chip : card.root.list(card.device + "/hwmon")) {
    const auto read_int = [&](std::string_view file) {
      return card.read_int(fmt::format("hwmon/{}/{}", chip, file));
    };
    facts.power_uw = read_int("power1_input");
    if (!facts.power_uw) facts.power_uw = read_int("power1_average");
    facts.power_cap_uw = read_int("power1_cap");
    for (int i = 1; i <= 3; ++i) {
      const std::string label =
          card.root.read_line(fmt::format("{}/hwmon/{}/temp{}_label", card.device, chip, i))
              .value_or("");
      const std::optional<int64_t> crit_mc = read_int(fmt::format("temp{}_crit", i));
      if (label == "edge") facts.edge_crit_mc = crit_mc;
      if (label == "junction") facts.hotspot_crit_mc = crit_mc;
      if (label == "mem") facts.mem_crit_mc = crit_mc;
    }
  }
  return facts;
}

// What the value should stay below or can reach, in the field's unit.
std::optional<int64_t> limit_of(const Card& card, const HwmonFacts& hwmon,
                                const MetricsField& field) {
  for (const Clock& clock : clocks)
    if (field.name == clock.name)
      return parse_levels(
                 card.root.read(fmt::format("{}/{}", card.device, clock.file)).text.value_or(""))
          .highest_mhz;
  const auto scaled = [](std::optional<int64_t> value, int64_t divisor) -> std::optional<int64_t> {
    if (!value || *value <= 0) return std::nullopt;
    return *value / divisor;
  };
  if (field.name == "socket_power")
    return scaled(hwmon.power_cap_uw, field.unit == Unit::watt ? 1'000'000 : 1'000);
  const int64_t per_unit_mc = field.unit == Unit::celsius ? 1'000 : 10;
  if (field.name == "temp_edge") return scaled(hwmon.edge_crit_mc, per_unit_mc);
  if (field.name == "temp_hotspot") return scaled(hwmon.hotspot_crit_mc, per_unit_mc);
  if (field.name == "temp_mem") return scaled(hwmon.mem_crit_mc, per_unit_mc);
  return std::nullopt;
}

// Fields of one table, all from the same read.
class MetricsSource final : public SensorSource {
 public:
  MetricsSource(std::vector<Channel> channels, SourceTraits traits, TextFile file,
                MetricsRevision revision, std::vector<MetricsField> fields)
      : SensorSource("amdgpu", metrics_period_ns, std::move(channels), std::move(traits)),
        file_(std::move(file)),
        revision_(revision),
        fields_(std::move(fields)) {}

  void poll(std::span<Reading> out) noexcept override {
    if (is_gone_) return std::fill(out.begin(), out.end(), Reading{PollStatus::gone});
    Page page;
    const TextFile::Read read = file_.read(page);
    const std::optional<MetricsRevision> revision = metrics_revision(read.text);
    // Another layout: the driver was exchanged under the run, and what was found at its start does
    // not hold any more.
    is_gone_ = revision && *revision != revision_;
    const bool is_readable = !is_gone_ && is_complete(read.text, revision_);
    for (size_t i = 0; i < fields_.size(); ++i) {
      out[i] = read.reading(is_readable ? fields_[i].value(read.text) : std::nullopt);
      if (is_gone_) out[i].status = PollStatus::gone;
    }
  }

 private:
  TextFile file_;
  MetricsRevision revision_;
  std::vector<MetricsField> fields_;
  bool is_gone_ = false;
};

// Current levels of pp_dpm_* files.
class LevelSource final : public SensorSource {
 public:
  LevelSource(std::vector<Channel> channels, SourceTraits traits, std::vector<TextFile> files)
      : SensorSource("amdgpu", file_period_ns, std::move(channels), std::move(traits)),
        files_(std::move(files)) {}

  void poll(std::span<Reading> out) noexcept override {
    for (size_t i = 0; i < files_.size(); ++i) {
      Page page;
      const TextFile::Read read = files_[i].read(page);
      out[i] = read.reading(parse_levels(read.text).current_mhz);
    }
  }

 private:
  std::vector<TextFile> files_;
};

// Of the fields of one name, the first with a value; units that firmware decides are settled.
std::vector<MetricsField> choose_fields(const Card& card, const HwmonFacts& hwmon,
                                        std::span<const char> table, MetricsRevision revision) {
  std::vector<MetricsField> chosen;
  std::set<std::string_view> names;
  for (MetricsField field : metrics_fields(revision, card.pci_device)) {
    const std::optional<int64_t> value = field.value(table);
    if (!value) continue;
    // Firmware without the sensor leaves 0, which no GPU in use is cold enough for; a counter of
    // energy that is 0 does not count.
    const bool is_unset = *value == 0 && (field.quantity == Quantity::temperature ||
                                          field.quantity == Quantity::energy);
    if (is_unset || !names.insert(field.name).second) continue;
    if (revision.format >= 2 && field.name == "socket_power")
      field.unit = socket_power_unit(*value, hwmon.power_uw);
    if (revision.format >= 2 && field.name == "activity")
      field.unit = activity_unit(revision, *value, card.read_int("gpu_busy_percent"));
    chosen.push_back(field);
  }
  return chosen;
}

// Why an error of a first read is met, and what helps.
void miss_unreadable(const Card& card, const TextFile& file, int error) {
  if (error == EPERM)
    card.miss(
        fmt::format("cannot read '{}': the GPU sleeps or is being reset", file.path()),
        fmt::format("echo on | sudo tee {}", card.root.display(card.device + "/power/control")));
  else
    card.miss(fmt::format("cannot read '{}': {}", file.path(), errno_text(error)));
}

// What the table has to say shows only in a table: while the firmware is busy it is asked again.
TextFile::Read read_patiently(TextFile& file, Page& page) {
  constexpr auto pause = std::chrono::milliseconds(5);
  constexpr int most_tries = 20;
  TextFile::Read read = file.read(page);
  for (int tries = 1; is_transient(read.error) && tries < most_tries; ++tries) {
    std::this_thread::sleep_for(pause);
    read = file.read(page);
  }
  return read;
}

// Adds the table's channels. Returns their names without the card's prefix.
std::set<std::string_view> discover_metrics(const Card& card) {
  TextFile file(card.root, card.device + "/gpu_metrics");
  Page page;
  const TextFile::Read read = read_patiently(file, page);
  if (read.error == ENOENT) {
    card.miss(
        fmt::format("'{}' is not there: the driver of this GPU tells neither throttling nor "
                    "the power of its parts",
                    file.path()));
    return {};
  }
  if (read.error != 0) {
    miss_unreadable(card, file, read.error);
    return {};
  }
  if (const std::string problem = metrics_problem(read.text); !problem.empty()) {
    card.miss(fmt::format("'{}' {}", file.path(), problem));
    return {};
  }
  const MetricsRevision revision = *metrics_revision(read.text);
  const HwmonFacts hwmon = read_hwmon(card);
  std::vector<MetricsField> fields = choose_fields(card, hwmon, read.text, revision);
  std::set<std::string_view> names;
  std::vector<Channel> channels;
  bool has_throttle = false;
  for (const MetricsField& field : fields) {
    Channel channel;
    channel.name = fmt::format("{}.{}", card.prefix, field.name);
    channel.quantity = field.quantity;
    channel.unit = field.unit;
    channel.kind = field.kind;
    if (field.kind == Kind::cumulative && field.width == 4) channel.wrap_at = 0xffff'ffff;
    channel.origin = fmt::format("{}: {}", file.path(), field.member);
    channel.limit = limit_of(card, hwmon, field);
    channels.push_back(std::move(channel));
    names.insert(field.name);
    has_throttle = has_throttle || field.quantity == Quantity::throttle;
  }
  if (channels.empty()) {
    card.miss(fmt::format("'{}' of revision {}.{} marks every value as unsupported", file.path(),
                          revision.format, revision.content));
    return {};
  }
  if (!has_throttle)
    card.miss(
        fmt::format("'{}' of revision {}.{} does not tell throttling in a way that is the "
                    "same for all GPUs",
                    file.path(), revision.format, revision.content));
  card.discovery.sources.push_back(std::make_unique<MetricsSource>(
      std::move(channels), card.traits, std::move(file), revision, std::move(fields)));
  return names;
}

// How busy the GPU and its memory are.
void discover_busy(const Card& card) {
  std::vector<FileChannel> rows;
  for (const auto& [name, path] :
       {std::pair{"busy", "gpu_busy_percent"}, std::pair{"mem_busy", "mem_busy_percent"}}) {
    CheckedFile checked = check_int_file(card.root, fmt::format("{}/{}", card.device, path));
    if (checked.error == ENOENT) continue;
    // EPERM: asleep or in reset, which passes.
    if (!checked.problem.empty() && checked.error != EPERM) {
      card.miss(checked.problem);
      continue;
    }
    Channel channel;
    channel.name = fmt::format("{}.{}", card.prefix, name);
    channel.quantity = Quantity::utilization;
    channel.unit = Unit::percent;
    channel.kind = Kind::average;
    rows.push_back({std::move(channel), std::move(checked.file)});
  }
  add_file_source(card.discovery, "amdgpu", file_period_ns, std::move(rows), card.traits);
}

// Clocks not in `known`, from their lists of levels.
void discover_levels(const Card& card, const std::set<std::string_view>& known) {
  std::vector<Channel> channels;
  std::vector<TextFile> files;
  for (const Clock& clock : clocks) {
    if (known.contains(clock.name)) continue;
    TextFile file(card.root, fmt::format("{}/{}", card.device, clock.file));
    Page page;
    const TextFile::Read read = file.read(page);
    if (read.error == ENOENT) continue;
    const Levels levels = parse_levels(read.text);
    if (read.error != 0 && read.error != EPERM && !is_transient(read.error)) {
      miss_unreadable(card, file, read.error);
      continue;
    }
    if (read.error == 0 && !levels.highest_mhz) {
      card.miss(fmt::format("'{}' lists no clock", file.path()));
      continue;
    }
    Channel channel;
    channel.name = fmt::format("{}.{}", card.prefix, clock.name);
    channel.quantity = Quantity::frequency;
    channel.unit = Unit::megahertz;
    channel.origin = file.path();
    channel.limit = levels.highest_mhz;
    channels.push_back(std::move(channel));
    files.push_back(std::move(file));
  }
  if (!channels.empty())
    card.discovery.sources.push_back(
        std::make_unique<LevelSource>(std::move(channels), card.traits, std::move(files)));
}

}  // namespace

void discover_amdgpu(const Root& root, Discovery& discovery) {
  const std::vector<NamedCard> cards = drm_cards_of(root, "amdgpu");
  if (cards.empty()) discovery.missing.push_back({"amdgpu", "no GPU with the driver amdgpu", ""});
  for (const NamedCard& named : cards) {
    const std::string device = named.card.path + "/device";
    SourceTraits traits;
    traits.slow = true;
    traits.wakes_device = may_sleep(root, device);  // drivers before Linux 6.13 wake it
    traits.gpu = named.card.gpu;
    const Card card{root,     named.prefix, device, pci_device_of(root, device), std::move(traits),
                    discovery};
    const std::set<std::string_view> names = discover_metrics(card);
    discover_busy(card);
    discover_levels(card, names);
  }
}

}  // namespace energyprof::probe
