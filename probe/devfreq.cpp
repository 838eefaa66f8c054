// Expects:
//
//   sys/class/devfreq/1c00000.gpu/{cur_freq,target_freq,max_freq}   400000000
//   sys/class/devfreq/1c00000.gpu/available_frequencies             in any order
//   sys/class/devfreq/1c00000.gpu/load                              22@300000000Hz (Rockchip)
//   sys/class/devfreq/1c00000.gpu/trans_stat                        a row per clock:
//        From  :   To
//              :  19200000 400000000   time(ms)
//      19200000:         0         2         0
//   * 400000000:         2         0    925683
//   Total transition : 4
//
// and on Tegra the load, per mille, at the GPU's device:
//
//   sys/class/devfreq/17000000.gpu/device/load, sys/devices/gpu.0/load,
//   sys/devices/platform/{gpu.0,17000000.gpu}/load, sys/devices/platform/bus@0/17000000.gpu/load
//
// and with Qualcomm's own Adreno driver:
//
//   sys/class/kgsl/kgsl-3d0/{gpuclk,max_gpuclk,gpu_busy_percentage,temp}   Hz, Hz, "22 %", mC
//   sys/class/kgsl/kgsl-3d0/gpu_available_frequencies                      in any order
#include "probe/devfreq.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <set>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/file_source.h"
#include "probe/names.h"

namespace energyprof::probe {

bool is_gpu_name(std::string_view text) {
  constexpr std::array<std::string_view, 11> marks{
      "gpu", "mali", "adreno", "kgsl", "v3d", "g3d", "ga10b", "gv11b", "gk20a", "panthor", "gp10b"};
  constexpr std::array<std::string_view, 3> others{"bw", "busmon", "ddr"};
  const auto has = [&](std::string_view mark) { return text.find(mark) != std::string_view::npos; };
  return std::any_of(marks.begin(), marks.end(), has) &&
         std::none_of(others.begin(), others.end(), has);
}

namespace {

constexpr std::string_view class_dir = "sys/class/devfreq";
constexpr std::string_view kgsl_dir = "sys/class/kgsl";
constexpr int64_t clock_period_ns = 20 * ns_per_ms;
constexpr int64_t stat_period_ns = 100 * ns_per_ms;
constexpr size_t largest_page_bytes = size_t{64} << 10;  // a sysfs file is one page at most

// The integer at the start of `text`, which loses it and the space before it.
std::optional<int64_t> take_int(std::string_view& text) {
  text.remove_prefix(std::min(text.find_first_not_of(" \t"), text.size()));
  int64_t value = 0;
  const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{}) return std::nullopt;
  text.remove_prefix(static_cast<size_t>(stop - text.data()));
  return value;
}

std::optional<int64_t> highest_listed(const Root& root, const std::string& path) {
  const std::string line = root.read_line(path).value_or("");
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
    for (TextFile& file : files_.clocks) out[next++] = read_clock(file);
    if (!files_.max) return;
    const Reading max = read_clock(*files_.max);
    out[next++] = max;
    if (next == out.size()) return;
    out[next] = max;
    out[next].value = max.value < files_.highest_hz ? 1 : 0;
  }

 private:
  static Reading read_clock(TextFile& file) noexcept {
    Reading reading = file.read_int();
    if (reading.status == PollStatus::ok && reading.value < 0) reading.status = PollStatus::retry;
    return reading;
  }

  Files files_;
};

// "22@300000000Hz", "22 %" or "990".
class LoadSource final : public SensorSource {
 public:
  LoadSource(Channel channel, TextFile file, SourceTraits traits)
      : SensorSource("devfreq", stat_period_ns, {std::move(channel)}, std::move(traits)),
        plausible_(plausible_values(channels().front())),
        file_(std::move(file)) {}

  void poll(std::span<Reading> out) noexcept override {
    std::array<char, 64> buffer;
    const TextFile::Read read = file_.read(buffer);
    std::string_view text = read.text;
    std::optional<int64_t> load = read.error == 0 ? take_int(text) : std::nullopt;
    if (load && !plausible_.has(*load)) load.reset();
    out[0] = read.reading(load);
  }

 private:
  Plausible plausible_;
  TextFile file_;
};

class TransSource final : public SensorSource {
 public:
  TransSource(std::vector<Channel> channels, std::vector<int64_t> clocks_hz, TextFile file,
              SourceTraits traits)
      : SensorSource("devfreq", stat_period_ns, std::move(channels), std::move(traits)),
        clocks_hz_(std::move(clocks_hz)),
        file_(std::move(file)),
        buffer_(largest_page_bytes) {}

  void poll(std::span<Reading> out) noexcept override {
    const TextFile::Read read = file_.read(buffer_);
    for (Reading& reading : out) reading = read.reading(std::nullopt);
    if (read.error != 0 || read.text.size() == buffer_.size()) return;  // a cut row would lie
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
  std::vector<char> buffer_;
};

void discover_clocks(const Root& root, const std::string& device, const std::string& prefix,
                     const SourceTraits& traits, Discovery& discovery) {
  const std::optional<int64_t> highest = highest_listed(root, device + "/available_frequencies");
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
    if (checked.value.value_or(0) < 0) {
      discovery.missing.push_back(
          {"devfreq",
           fmt::format("'{}' reads {} Hz, which cannot be", checked.file.path(), *checked.value),
           ""});
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

void add_load(const Root& root, const std::string& path, const std::string& prefix, Unit unit,
              const SourceTraits& traits, Discovery& discovery) {
  TextFile file(root, path);
  Channel channel =
      make_channel(prefix + ".load", Quantity::utilization, unit, Kind::gauge, file.path());
  discovery.sources.push_back(
      std::make_unique<LoadSource>(std::move(channel), std::move(file), traits));
}

// Whether `path` holds a load, or will: a GPU whose rail is off may say EAGAIN.
bool has_load(const Root& root, const std::string& path) {
  const Root::Text text = root.read(path);
  std::string_view rest = text.text ? *text.text : std::string_view();
  return is_transient(text.error) || take_int(rest).has_value();
}

// Returns the resolved path of a load that was found.
std::string discover_load(const Root& root, const std::string& device, const std::string& prefix,
                          const SourceTraits& traits, Discovery& discovery) {
  const std::string own = device + "/load";
  const std::string of_device = device + "/device/load";
  if (has_load(root, own)) {
    add_load(root, own, prefix, Unit::percent, traits, discovery);
    return root.resolve(own).path;
  }
  if (has_load(root, of_device)) {
    add_load(root, of_device, prefix, Unit::permille, traits, discovery);
    return root.resolve(of_device).path;
  }
  return {};
}

// Loads of Tegra GPUs whose devfreq device does not lead to them, or that have none. `known` are
// resolved paths of loads that were found.
void discover_tegra_loads(const Root& root, std::set<std::string> known, Discovery& discovery) {
  for (const std::string parent :
       {"sys/devices", "sys/devices/platform", "sys/devices/platform/bus@0"})
    for (const std::string& entry : root.list(parent)) {
      const std::string path = fmt::format("{}/{}/load", parent, entry);
      const Root::Resolved resolved = root.resolve(path);
      if (!is_gpu_name(entry) || resolved.error != 0 || !has_load(root, path) ||
          !known.insert(resolved.path).second)
        continue;
      const std::string gpu = gpu_of_device(root, fmt::format("{}/{}", parent, entry));
      add_load(root, path, "devfreq." + slug(gpu), Unit::permille, SourceTraits{.gpu = gpu},
               discovery);
    }
}

void discover_transitions(const Root& root, const std::string& device, const std::string& prefix,
                          const SourceTraits& traits, Discovery& discovery) {
  const std::string path = device + "/trans_stat";
  const Root::Text stat = root.read(path);
  if (stat.text && stat.text->size() >= largest_page_bytes) {
    discovery.missing.push_back(
        {"devfreq", fmt::format("'{}' is longer than a page", root.display(path)), ""});
    return;
  }
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

// Adreno GPUs of Qualcomm's own driver, which Android devices have.
void discover_kgsl(const Root& root, Discovery& discovery) {
  for (const std::string& entry : root.list(kgsl_dir)) {
    const std::string device = fmt::format("{}/{}", kgsl_dir, entry);
    const std::string prefix = "devfreq." + slug(entry);
    std::string gpu = gpu_of_device(root, device + "/device");
    const SourceTraits traits{.gpu = gpu.empty() ? entry : std::move(gpu)};
    // Its clock is in the other class, too, where Android's kernel has that.
    const bool has_clock =
        std::any_of(discovery.sources.begin(), discovery.sources.end(), [&](const auto& source) {
          return source->name() == "devfreq" && source->traits().gpu == traits.gpu;
        });
    std::vector<FileChannel> clocks;
    std::vector<FileChannel> limits;
    std::vector<FileChannel> heat;
    const auto add = [&](std::vector<FileChannel>& rows, const char* what, Quantity quantity,
                         Unit unit, std::optional<int64_t> limit, const char* file) {
      Channel channel = make_channel(fmt::format("{}.{}", prefix, what), quantity, unit);
      channel.limit = limit;
      add_file_row(root, discovery, "devfreq", rows, std::move(channel),
                   fmt::format("{}/{}", device, file));
    };
    const auto allowed = check_int_file(root, device + "/max_gpuclk").value;
    const auto highest = highest_listed(root, device + "/gpu_available_frequencies");
    if (!has_clock)
      add(clocks, "freq", Quantity::frequency, Unit::hertz, highest ? highest : allowed, "gpuclk");
    add(limits, "max_freq", Quantity::limit, Unit::hertz, highest, "max_gpuclk");
    add(heat, "temp", Quantity::temperature, Unit::millicelsius, std::nullopt, "temp");
    add_file_source(discovery, "devfreq", clock_period_ns, std::move(clocks), traits);
    add_file_source(discovery, "devfreq", clock_period_ns, std::move(limits), traits);
    add_file_source(discovery, "devfreq", stat_period_ns, std::move(heat), traits);
    const std::string load = device + "/gpu_busy_percentage";
    if (has_load(root, load)) add_load(root, load, prefix, Unit::percent, traits, discovery);
  }
}

// The name of a device of the class. Kernels 4.16 to 4.19 number the entries ("devfreq0").
std::string device_name(const Root& root, const std::string& entry) {
  constexpr std::string_view numbered = "devfreq";
  if (!entry.starts_with(numbered) ||
      entry.find_first_not_of("0123456789", numbered.size()) != std::string::npos)
    return entry;
  const std::string device = fmt::format("{}/{}", class_dir, entry);
  if (auto name = root.read_line(device + "/name")) return *name;
  const std::string parent = gpu_of_device(root, device + "/device");
  return parent.empty() ? entry : parent;
}

// What driver and device tree call the device: "DRIVER=panfrost", "OF_COMPATIBLE_0=arm,mali-...".
bool is_driven_as_gpu(const Root& root, const std::string& device) {
  constexpr std::array<std::string_view, 6> drivers{"panfrost", "panthor", "lima",
                                                    "nvgpu",    "msm",     "etnaviv"};
  const std::string uevent = root.read(device + "/device/uevent").text.value_or("");
  for (std::string_view text = uevent; !text.empty();) {
    const std::string_view line = take_line(text);
    if (line.starts_with("DRIVER=") &&
        std::find(drivers.begin(), drivers.end(), line.substr(line.find('=') + 1)) != drivers.end())
      return true;
    if ((line.starts_with("OF_NAME=") || line.starts_with("OF_COMPATIBLE_")) &&
        is_gpu_name(line.substr(line.find('='))))
      return true;
  }
  return false;
}

// As SourceTraits::gpu.
std::string gpu_of_entry(const Root& root, const std::string& entry) {
  std::string gpu = gpu_of_device(root, fmt::format("{}/{}/device", class_dir, entry));
  return gpu.empty() ? device_name(root, entry) : gpu;
}

bool is_gpu(const Root& root, const std::string& entry) {
  return is_gpu_name(device_name(root, entry)) ||
         is_driven_as_gpu(root, fmt::format("{}/{}", class_dir, entry));
}

}  // namespace

std::string only_devfreq_gpu(const Root& root) {
  const std::vector<std::string> entries = root.list(class_dir);
  const bool is_one = entries.size() == 1 && is_gpu(root, entries.front());
  return is_one ? gpu_of_entry(root, entries.front()) : "";
}

void discover_devfreq(const Root& root, Discovery& discovery) {
  const size_t source_count = discovery.sources.size();
  std::vector<std::string> others;
  bool found_gpu = false;
  std::set<std::string> loads;
  for (const std::string& entry : root.list(class_dir)) {
    const std::string device = fmt::format("{}/{}", class_dir, entry);
    const std::string name = device_name(root, entry);
    if (!is_gpu(root, entry)) {
      others.push_back(name);
      continue;
    }
    const size_t sources_before = discovery.sources.size();
    const size_t missing_before = discovery.missing.size();
    const std::string prefix = "devfreq." + slug(name);
    const SourceTraits traits{.gpu = gpu_of_entry(root, entry)};
    discover_clocks(root, device, prefix, traits, discovery);
    loads.insert(discover_load(root, device, prefix, traits, discovery));
    discover_transitions(root, device, prefix, traits, discovery);
    if (discovery.sources.size() == sources_before && discovery.missing.size() == missing_before)
      discovery.missing.push_back(
          {"devfreq", fmt::format("'{}' has no clock to read", root.display(device)), ""});
    found_gpu = true;
  }
  discover_tegra_loads(root, std::move(loads), discovery);
  discover_kgsl(root, discovery);
  if (!others.empty())
    discovery.missing.push_back({"devfreq",
                                 fmt::format("{} in '{}': no GPU, not recorded",
                                             fmt::join(others, ", "), root.display(class_dir)),
                                 ""});
  else if (discovery.sources.size() == source_count && !found_gpu)
    discovery.missing.push_back(
        {"devfreq", fmt::format("no device in '{}'", root.display(class_dir)), ""});
}

}  // namespace energyprof::probe
