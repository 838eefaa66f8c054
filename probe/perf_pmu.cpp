// Expects:
//
//   sys/bus/event_source/devices/power/type                        17
//   sys/bus/event_source/devices/power/cpumask                     0
//   sys/bus/event_source/devices/power/format/event                config:0-7
//   sys/bus/event_source/devices/power/events/energy-pkg           event=0x02
//   sys/bus/event_source/devices/power/events/energy-pkg.scale     2.3283064365386962890625e-10
//   sys/bus/event_source/devices/power/events/energy-pkg.unit      Joules
#include "probe/perf_pmu.h"

#include <fmt/format.h>
#include <linux/perf_event.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <limits>
#include <system_error>
#include <utility>

#include "core/clock.h"
#include "probe/names.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view devices_dir = "sys/bus/event_source/devices";

std::optional<uint64_t> parse_number(std::string_view text) {
  const bool is_hex = text.starts_with("0x") || text.starts_with("0X");
  if (is_hex) text.remove_prefix(2);
  uint64_t value = 0;
  const auto [stop, error] =
      std::from_chars(text.data(), text.data() + text.size(), value, is_hex ? 16 : 10);
  if (error != std::errc{} || text.empty() || stop != text.data() + text.size())
    return std::nullopt;
  return value;
}

// The part of `text` before the separator; `text` keeps what is behind it.
std::string_view take(std::string_view& text, char separator) {
  const size_t end = std::min(text.find(separator), text.size());
  const std::string_view part = text.substr(0, end);
  text.remove_prefix(std::min(end + 1, text.size()));
  return part;
}

// "config", "config1", "config2" -> 0, 1, 2.
std::optional<size_t> word_index(std::string_view name) {
  if (name == "config") return 0;
  if (name == "config1") return 1;
  if (name == "config2") return 2;
  return std::nullopt;
}

struct BitRange {
  uint64_t first = 0;
  uint64_t last = 0;
};

// "0-7" or "20".
std::optional<BitRange> parse_bits(std::string_view text) {
  const std::string_view first_text = take(text, '-');
  const auto first = parse_number(first_text);
  const auto last = text.empty() ? first : parse_number(text);
  if (!first || !last || *last > 63 || *first > *last) return std::nullopt;
  return BitRange{*first, *last};
}

// Puts `value` where `format` ("config1:12-15,20") says, lowest bits first. False if it does not
// fit, or the format is none.
bool place(EventCode& code, std::string_view format, uint64_t value) {
  const auto word = word_index(take(format, ':'));
  if (!word || format.empty()) return false;
  while (!format.empty()) {
    const auto bits = parse_bits(take(format, ','));
    if (!bits) return false;
    const uint64_t width = bits->last - bits->first + 1;
    const uint64_t mask =
        width == 64 ? std::numeric_limits<uint64_t>::max() : (uint64_t{1} << width) - 1;
    code.config[*word] |= (value & mask) << bits->first;
    value = width == 64 ? 0 : value >> width;
  }
  return value == 0;
}

// How an event's unit is recorded.
struct Conversion {
  Unit unit = Unit::count;
  long double factor = 1;
};

Conversion conversion_of(std::string_view unit, long double scale) {
  if (unit == "Joules") return {Unit::nanojoule, scale * 1e9L};
  if (unit == "MiB") return {Unit::byte, scale * 1048576.0L};
  if (unit == "Bytes") return {Unit::byte, scale};
  if (unit == "ns") return {Unit::nanosecond, scale};
  if (unit == "ms") return {Unit::millisecond, scale};
  if (unit == "M") return {Unit::count, scale * 1e6L};
  return {Unit::count, scale};
}

// A channel of one event on each of the unit's CPUs.
ChannelPlan plan_code(const Pmu& pmu, std::string_view event, const EventCode& code,
                      const Conversion& conversion) {
  ChannelPlan plan;
  plan.channel.unit = conversion.unit;
  plan.channel.kind = Kind::cumulative;
  plan.channel.origin = fmt::format("perf {}/{}/", pmu.name, event);
  plan.factor = conversion.factor;
  CounterPlan counter;
  counter.type = pmu.type;
  counter.config = code.config;
  counter.pinned = true;
  for (const int cpu : pmu.cpus) {
    counter.cpu = cpu;
    plan.counters.push_back(counter);
  }
  return plan;
}

// Channels of counters, each the sum of its own.
class CounterSource final : public SensorSource {
 public:
  struct Row {
    long double factor = 1;
    std::vector<Counter> counters;
  };
  CounterSource(std::string name, int64_t period_ns, std::vector<Channel> channels,
                std::vector<Row> rows, SourceTraits traits)
      : SensorSource(std::move(name), period_ns, std::move(channels), std::move(traits)),
        rows_(std::move(rows)) {}

  void poll(std::span<Reading> out) noexcept override {
    for (size_t i = 0; i < rows_.size(); ++i) out[i] = read(rows_[i]);
  }

 private:
  static Reading read(const Row& row) noexcept {
    const int64_t before_ns = now_ns();
    long double sum = 0;
    int error = 0;
    for (const Counter& counter : row.counters) {
      const Counter::Count count = counter.read();
      if (count.error != 0) error = count.error;
      sum += static_cast<long double>(count.value);
    }
    const int64_t width_ns = now_ns() - before_ns;
    Reading reading{status_of(error), before_ns + width_ns / 2, 0, width_ns, error};
    if (reading.status != PollStatus::ok) return reading;
    const long double value = std::floor(sum * row.factor);
    if (value < 9.2e18L)
      reading.value = static_cast<int64_t>(value);
    else
      reading.status = PollStatus::retry;
    return reading;
  }

  std::vector<Row> rows_;
};

}  // namespace

std::string running_program() {
  std::error_code error;
  const std::filesystem::path path = std::filesystem::read_symlink("/proc/self/exe", error);
  return error ? "energyprof" : fmt::format("'{}'", path.string());
}

std::optional<std::vector<int>> parse_cpu_list(std::string_view text) {
  constexpr size_t most = 4096;
  std::vector<int> cpus;
  text = trim(text);
  if (text.empty()) return std::nullopt;
  while (!text.empty()) {
    std::string_view part = take(text, ',');
    const auto first = parse_number(take(part, '-'));
    const auto last = part.empty() ? first : parse_number(part);
    if (!first || !last || *first > *last || *last - *first >= most) return std::nullopt;
    for (uint64_t cpu = *first; cpu <= *last; ++cpu) {
      if (cpu > 1'000'000 || cpus.size() >= most) return std::nullopt;
      cpus.push_back(static_cast<int>(cpu));
    }
  }
  return cpus;
}

EventCode encode_event(std::string_view event, const std::map<std::string, std::string>& formats) {
  EventCode code;
  event = trim(event);
  if (event.empty()) code.problem = "it is empty";
  while (!event.empty() && code.problem.empty()) {
    std::string_view text = take(event, ',');
    const bool has_value = text.find('=') != std::string_view::npos;
    const std::string_view term = trim(take(text, '='));
    const auto value = has_value ? parse_number(trim(text)) : std::optional<uint64_t>(1);
    if (!value) {
      code.problem =
          fmt::format("'{}' has no number behind '{}='", text.substr(0, 64), term.substr(0, 64));
    } else if (const auto word = word_index(term)) {
      code.config[*word] |= *value;
    } else if (const auto format = formats.find(std::string(term)); format == formats.end()) {
      code.problem = fmt::format("no format says where '{}' goes", term.substr(0, 64));
    } else if (!place(code, trim(format->second), *value)) {
      code.problem = fmt::format("{} does not fit '{}' at '{}'", *value, term,
                                 std::string_view(format->second).substr(0, 64));
    }
  }
  return code;
}

std::vector<std::string> list_pmus(const Root& root) { return root.list(devices_dir); }

std::vector<Pmu> list_core_pmus(const Root& root) {
  std::vector<Pmu> kinds;
  for (const std::string& name : list_pmus(root))
    if (root.exists(fmt::format("{}/{}/cpus", devices_dir, name)))
      if (auto pmu = read_pmu(root, name)) kinds.push_back(std::move(*pmu));
  if (kinds.size() == 1) kinds.clear();
  return kinds;
}

std::optional<Pmu> read_pmu(const Root& root, std::string_view name) {
  Pmu pmu;
  pmu.name = name;
  const std::string path = fmt::format("{}/{}", devices_dir, name);
  const auto type = parse_int(root.read_line(path + "/type").value_or(""));
  if (!type || *type < 0 || *type > std::numeric_limits<uint32_t>::max()) return std::nullopt;
  pmu.type = static_cast<uint32_t>(*type);
  for (const char* file : {"cpumask", "cpus"})
    if (auto cpus = parse_cpu_list(root.read_line(fmt::format("{}/{}", path, file)).value_or("")))
      if (pmu.cpus.empty()) pmu.cpus = std::move(*cpus);
  if (pmu.cpus.empty()) pmu.cpus = {0};
  for (const std::string& term : root.list(path + "/format"))
    if (auto format = root.read_line(fmt::format("{}/format/{}", path, term)))
      pmu.formats.emplace(term, std::move(*format));
  return pmu;
}

std::optional<ChannelPlan> plan_event(const Root& root, const Pmu& pmu, std::string_view event,
                                      std::string_view source, Discovery& discovery) {
  const std::string path = fmt::format("{}/{}/events/{}", devices_dir, pmu.name, event);
  const auto text = root.read_line(path);
  if (!text) return std::nullopt;
  const EventCode code = encode_event(*text, pmu.formats);
  if (!code.problem.empty()) {
    discovery.missing.push_back(
        {std::string(source),
         fmt::format("cannot encode '{}': {}", root.display(path), code.problem), ""});
    return std::nullopt;
  }
  const std::string scale_text = root.read_line(path + ".scale").value_or("1");
  long double scale = 1;
  char* end = nullptr;
  scale = std::strtold(scale_text.c_str(), &end);
  if (end == scale_text.c_str() || !(scale > 0) || !std::isfinite(scale)) {
    discovery.missing.push_back({std::string(source),
                                 fmt::format("'{}.scale' holds '{}', which is no positive number",
                                             root.display(path), shown(scale_text)),
                                 ""});
    return std::nullopt;
  }
  const Conversion conversion = conversion_of(root.read_line(path + ".unit").value_or(""), scale);
  return plan_code(pmu, event, code, conversion);
}

std::optional<ChannelPlan> plan_unlisted_event(const Pmu& pmu, std::string_view event, Unit unit,
                                               long double factor) {
  const EventCode code = encode_event(event, pmu.formats);
  if (!code.problem.empty()) return std::nullopt;
  return plan_code(pmu, event, code, {unit, factor});
}

int Counter::open(const CounterPlan& plan) {
  perf_event_attr attr{};
  attr.size = sizeof attr;
  attr.type = plan.type;
  attr.config = plan.config[0];
  attr.config1 = plan.config[1];
  attr.config2 = plan.config[2];
  // Units that count for the whole machine refuse any exclusion.
  if (plan.pid >= 0) {
    attr.inherit = 1;
    attr.exclude_hv = 1;
    attr.exclude_kernel = plan.exclude_kernel ? 1 : 0;
  }
  attr.pinned = plan.pinned ? 1 : 0;
  attr.read_format = PERF_FORMAT_TOTAL_TIME_ENABLED | PERF_FORMAT_TOTAL_TIME_RUNNING;
  const long fd = syscall(SYS_perf_event_open, &attr, plan.pid, plan.cpu, -1, PERF_FLAG_FD_CLOEXEC);
  return fd < 0 ? -errno : static_cast<int>(fd);
}

Counter::~Counter() {
  if (fd_ >= 0) close(fd_);
}

Counter::Counter(Counter&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}

Counter::Count Counter::read() const noexcept {
  std::array<uint64_t, 3> words{};
  const ssize_t got = ::read(fd_, words.data(), sizeof words);
  if (got == static_cast<ssize_t>(sizeof words)) return {words[0], words[1], words[2], 0};
  // The end of the file: a pinned counter that the hardware has no room for.
  return {0, 0, 0, got < 0 ? errno : ENODEV};
}

std::optional<int64_t> lowest_running_ppm(std::span<const CountedTime> times, bool of_processors) {
  std::optional<int64_t> lowest;
  for (size_t first = 0, end = 0; first < times.size(); first = end) {
    uint64_t enabled_ns = 0;
    uint64_t running_ns = 0;
    for (; end < times.size() && times[end].event == times[first].event; ++end) {
      running_ns += times[end].running_ns;
      enabled_ns = of_processors ? enabled_ns + times[end].enabled_ns
                                 : std::max(enabled_ns, times[end].enabled_ns);
    }
    if (enabled_ns == 0) continue;
    const auto ppm = static_cast<int64_t>(static_cast<double>(running_ns) * 1e6 /
                                          static_cast<double>(enabled_ns));
    lowest = std::min(lowest.value_or(ppm), ppm);
  }
  return lowest;
}

bool is_refusal(int error) { return error == EACCES || error == EPERM; }

Missing explain_counters(const Root& root, const std::string& source, const std::string& names,
                         int error, int paranoid) {
  Missing missing{source, fmt::format("cannot count {}: {}", names, errno_text(error)), ""};
  if (is_refusal(error)) {
    const std::string level =
        root.read_line("proc/sys/kernel/perf_event_paranoid").value_or("unknown");
    missing.reason += fmt::format("; kernel.perf_event_paranoid is {}", level);
    if (parse_int(level).value_or(paranoid + 1) > paranoid) {
      missing.reason += fmt::format(", and this needs {} or less, or CAP_PERFMON", paranoid);
      missing.fix = "sudo setcap cap_perfmon+ep " + running_program();
    } else {
      missing.reason += ", which allows it: a container's system call filter does not";
      missing.fix = "docker run --cap-add PERFMON ...";
    }
  } else if (error == EMFILE) {
    missing.reason += "; each counter on each processor is a file";
    missing.fix = "ulimit -n \"$(ulimit -Hn)\"";
  } else if (error == ENOENT || error == EOPNOTSUPP) {
    missing.reason += "; usual in a virtual machine, which has no hardware counters";
  }
  return missing;
}

void add_counters(const Root& root, Discovery& discovery, const std::string& source,
                  int64_t period_ns, std::vector<ChannelPlan> plans, SourceTraits traits) {
  std::vector<Channel> channels;
  std::vector<CounterSource::Row> rows;
  std::map<int, std::string> failures;  // errno -> what it was the answer to
  std::string crowded_out;
  const auto append = [](std::string& names, const std::string& name) {
    names += fmt::format("{}'{}'", names.empty() ? "" : ", ", name);
  };
  for (ChannelPlan& plan : plans) {
    CounterSource::Row row{plan.factor, {}};
    int error = 0;
    bool has_room = true;
    for (const CounterPlan& counter : plan.counters) {
      const int fd = Counter::open(counter);
      if (fd < 0) {
        error = -fd;
        break;
      }
      has_room = row.counters.emplace_back(fd).read().error == 0 && has_room;
    }
    if (error != 0) {
      append(failures[error], plan.channel.origin);
    } else if (!has_room) {
      append(crowded_out, plan.channel.origin);
    } else {
      channels.push_back(std::move(plan.channel));
      rows.push_back(std::move(row));
    }
  }
  for (const auto& [error, names] : failures)
    discovery.missing.push_back(explain_counters(root, source, names, error, 0));
  if (!crowded_out.empty())
    discovery.missing.push_back(
        {source,
         fmt::format("cannot count {}: other programs use the unit's counters", crowded_out), ""});
  if (!channels.empty())
    discovery.sources.push_back(std::make_unique<CounterSource>(
        source, period_ns, std::move(channels), std::move(rows), std::move(traits)));
}

}  // namespace energyprof::probe
