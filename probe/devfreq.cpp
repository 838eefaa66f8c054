// Expects:
//
//   sys/class/devfreq/1c00000.gpu/cur_freq  target_freq  max_freq     400000000
//   sys/class/devfreq/1c00000.gpu/available_frequencies               19200000 400000000, in any
//   order sys/class/devfreq/1c00000.gpu/load                                22@300000000Hz;
//   Rockchip sys/class/devfreq/1c00000.gpu/device/load                         990, per mille;
//   Tegra sys/class/devfreq/1c00000.gpu/trans_stat                          a row per clock:
//        From  :   To
//              :  19200000 400000000   time(ms)
//      19200000:         0         2         0
//   * 400000000:         2         0    925683
//   Total transition : 4
#include "probe/devfreq.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/file_source.h"
#include "probe/names.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view class_dir = "sys/class/devfreq";
constexpr int64_t clock_period_ns = 20 * ns_per_ms;
constexpr int64_t stat_period_ns = 100 * ns_per_ms;

// The integer at the start of `text`, which loses it and the space before it.
std::optional<int64_t> take_int(std::string_view& text) {
  text.remove_prefix(std::min(text.find_first_not_of(" \t"), text.size()));
  int64_t value = 0;
  const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{}) return std::nullopt;
  text.remove_prefix(static_cast<size_t>(stop - text.data()));
  return value;
}

std::optional<int64_t> highest_available(const Root& root, const std::string& device) {
  const std::string line = root.read_line(device + "/available_frequencies").value_or("");
  std::string_view rest = line;
  std::optional<int64_t> highest;
  while (const auto value = take_int(rest)) highest = std::max(highest.value_or(*value), *value);
  return highest;
}

std::string_view take_line(std::string_view& text) {
  const size_t end = std::min(text.find('\n'), text.size());
  const std::string_view line = text.substr(0, end);
  text.remove_prefix(std::min(end + 1, text.size()));
  return line;
}

// The clock that a row of trans_stat is about and its last column, ms; nullopt for other lines.
std::optional<std::pair<int64_t, int64_t>> parse_row(std::string_view line) {
  line.remove_prefix(std::min(line.find_first_not_of(" *"), line.size()));
  const std::optional<int64_t> clock = take_int(line);
  if (!clock || !line.starts_with(':')) return std::nullopt;
  line.remove_prefix(1);
  std::optional<int64_t> last;
  while (const auto value = take_int(line)) last = value;
  if (!last) return std::nullopt;
  return std::pair{*clock, *last};
}

constexpr std::string_view total_key = "Total transition :";

// The clock now, the one asked for, the highest allowed, and whether that is clamped.
class ClockSource final : public SensorSource {
 public:
  struct Files {
    std::vector<TextFile> clocks;  // one channel each
    std::optional<TextFile> max;   // two channels
    int64_t highest_hz = 0;
  };
  ClockSource(std::vector<Channel> channels, Files files, SourceTraits traits)
      : SensorSource("devfreq", clock_period_ns, std::move(channels), std::move(traits)),
        files_(std::move(files)) {}

  void poll(std::span<Reading> out) noexcept override {
    size_t next = 0;
    for (TextFile& file : files_.clocks) out[next++] = file.read_int();
    if (!files_.max) return;
    const Reading max = files_.max->read_int();
    out[next++] = max;
    if (next == out.size()) return;
    out[next] = max;
    out[next].value = max.value < files_.highest_hz ? 1 : 0;
  }

 private:
  Files files_;
};

// "22@300000000Hz" or "990".
class LoadSource final : public SensorSource {
 public:
  LoadSource(Channel channel, TextFile file, SourceTraits traits)
      : SensorSource("devfreq", stat_period_ns, {std::move(channel)}, std::move(traits)),
        file_(std::move(file)) {}

  void poll(std::span<Reading> out) noexcept override {
    std::array<char, 64> buffer;
    const TextFile::Read read = file_.read(buffer);
    std::string_view text = read.text;
    out[0] = read.reading(read.error == 0 ? take_int(text) : std::nullopt);
  }

 private:
  TextFile file_;
};

class TransSource final : public SensorSource {
 public:
  TransSource(std::vector<Channel> channels, std::vector<int64_t> clocks_hz, TextFile file,
              SourceTraits traits)
      : SensorSource("devfreq", stat_period_ns, std::move(channels), std::move(traits)),
        clocks_hz_(std::move(clocks_hz)),
        file_(std::move(file)) {}

  void poll(std::span<Reading> out) noexcept override {
    std::array<char, 8192> buffer;
    const TextFile::Read read = file_.read(buffer);
    for (Reading& reading : out) reading = read.reading(std::nullopt);
    if (read.error != 0) return;
    for (std::string_view text = read.text; !text.empty();) {
      std::string_view line = take_line(text);
      if (line.starts_with(total_key)) {
        line.remove_prefix(total_key.size());
        out.back() = read.reading(take_int(line));
      } else if (const auto row = parse_row(line)) {
        const auto known = std::find(clocks_hz_.begin(), clocks_hz_.end(), row->first);
        if (known != clocks_hz_.end())
          out[static_cast<size_t>(known - clocks_hz_.begin())] = read.reading(row->second);
      }
    }
  }

 private:
  std::vector<int64_t> clocks_hz_;
  TextFile file_;
};

Channel make_channel(std::string name, Quantity quantity, Unit unit, Kind kind,
                     std::string origin) {
  Channel channel;
  channel.name = std::move(name);
  channel.quantity = quantity;
  channel.unit = unit;
  channel.kind = kind;
  channel.origin = std::move(origin);
  return channel;
}

void discover_clocks(const Root& root, const std::string& device, const std::string& prefix,
                     const SourceTraits& traits, Discovery& discovery) {
  const std::optional<int64_t> highest = highest_available(root, device);
  std::vector<Channel> channels;
  ClockSource::Files files;
  files.highest_hz = highest.value_or(0);
  for (const auto& [file, suffix] :
       {std::pair{"cur_freq", "freq"}, std::pair{"target_freq", "target_freq"},
        std::pair{"max_freq", "max_freq"}}) {
    CheckedFile checked = check_int_file(root, fmt::format("{}/{}", device, file));
    if (!checked.problem.empty()) {
      if (checked.error != ENOENT) discovery.missing.push_back({"devfreq", checked.problem, ""});
      continue;
    }
    const bool is_limit = std::string_view(file) == "max_freq";
    channels.push_back(make_channel(fmt::format("{}.{}", prefix, suffix),
                                    is_limit ? Quantity::limit : Quantity::frequency, Unit::hertz,
                                    Kind::gauge, checked.file.path()));
    channels.back().limit = highest;
    if (!is_limit) {
      files.clocks.push_back(std::move(checked.file));
      continue;
    }
    if (highest)
      channels.push_back(
          make_channel(prefix + ".throttle.clamp", Quantity::throttle, Unit::count, Kind::flag,
                       fmt::format("{} below {} Hz", checked.file.path(), *highest)));
    files.max.emplace(std::move(checked.file));
  }
  if (!channels.empty())
    discovery.sources.push_back(
        std::make_unique<ClockSource>(std::move(channels), std::move(files), traits));
}

void discover_load(const Root& root, const std::string& device, const std::string& prefix,
                   const SourceTraits& traits, Discovery& discovery) {
  struct Place {
    std::string path;
    Unit unit;
  };
  for (const Place& place :
       {Place{device + "/load", Unit::percent}, Place{device + "/device/load", Unit::permille}}) {
    const std::string text = root.read_line(place.path).value_or("");
    std::string_view rest = text;
    if (!take_int(rest)) continue;
    TextFile file(root, place.path);
    Channel channel =
        make_channel(prefix + ".load", Quantity::utilization, place.unit, Kind::gauge, file.path());
    discovery.sources.push_back(
        std::make_unique<LoadSource>(std::move(channel), std::move(file), traits));
    return;
  }
}

void discover_transitions(const Root& root, const std::string& device, const std::string& prefix,
                          const SourceTraits& traits, Discovery& discovery) {
  const std::string path = device + "/trans_stat";
  const Root::Text stat = root.read(path);
  if (!stat.text) {
    // EFBIG: the table does not fit a page.
    if (stat.error != ENOENT)
      discovery.missing.push_back(
          {"devfreq",
           fmt::format("cannot read '{}': {}", root.display(path), errno_text(stat.error)), ""});
    return;
  }
  TextFile file(root, path);
  std::vector<Channel> channels;
  std::vector<int64_t> clocks_hz;
  bool has_total = false;
  for (std::string_view text = *stat.text; !text.empty();) {
    const std::string_view line = take_line(text);
    has_total = has_total || line.starts_with(total_key);
    const auto row = parse_row(line);
    if (!row) continue;
    clocks_hz.push_back(row->first);
    channels.push_back(make_channel(fmt::format("{}.time_at.{}", prefix, row->first),
                                    Quantity::utilization, Unit::millisecond, Kind::cumulative,
                                    file.path()));
  }
  if (!has_total || clocks_hz.empty()) return;  // "Not Supported." and the like
  channels.push_back(make_channel(prefix + ".transitions", Quantity::utilization, Unit::count,
                                  Kind::cumulative, file.path()));
  discovery.sources.push_back(std::make_unique<TransSource>(
      std::move(channels), std::move(clocks_hz), std::move(file), traits));
}

}  // namespace

bool is_gpu_name(std::string_view device) {
  constexpr std::array<std::string_view, 10> marks{"gpu",   "mali",  "adreno", "kgsl",  "v3d",
                                                   "ga10b", "gv11b", "gk20a",  "gp10b", "panthor"};
  return std::any_of(marks.begin(), marks.end(), [&](std::string_view mark) {
    return device.find(mark) != std::string_view::npos;
  });
}

void discover_devfreq(const Root& root, Discovery& discovery) {
  const size_t source_count = discovery.sources.size();
  std::vector<std::string> others;
  for (const std::string& entry : root.list(class_dir)) {
    if (!is_gpu_name(entry)) {
      others.push_back(entry);
      continue;
    }
    const std::string device = fmt::format("{}/{}", class_dir, entry);
    const std::string prefix = "devfreq." + slug(entry);
    std::string gpu = gpu_of_device(root, device + "/device");
    const SourceTraits traits{.gpu = gpu.empty() ? entry : std::move(gpu)};
    discover_clocks(root, device, prefix, traits, discovery);
    discover_load(root, device, prefix, traits, discovery);
    discover_transitions(root, device, prefix, traits, discovery);
  }
  if (discovery.sources.size() > source_count) return;
  discovery.missing.push_back({"devfreq",
                               others.empty()
                                   ? fmt::format("no device in '{}'", root.display(class_dir))
                                   : fmt::format("no GPU in '{}': only {}", root.display(class_dir),
                                                 fmt::join(others, ", ")),
                               ""});
}

}  // namespace energyprof::probe
