// Expects /proc/stat to begin with
//
//   cpu  user nice system idle iowait irq softirq steal guest guest_nice
#include "probe/proc_stat.h"

#include <fmt/format.h>

#include <array>
#include <charconv>
#include <utility>

#include "core/clock.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view path = "proc/stat";

struct CpuTicks {
  int64_t busy = 0;
  int64_t steal = 0;
};

// nullopt unless the line starts with "cpu " and eight numbers.
std::optional<CpuTicks> parse_cpu_line(std::string_view text) {
  if (!text.starts_with("cpu ")) return std::nullopt;
  const char* at = text.data() + 4;
  const char* const end = text.data() + text.size();
  std::array<int64_t, 8> ticks{};
  for (int64_t& tick : ticks) {
    while (at != end && *at == ' ') ++at;
    const auto [stop, error] = std::from_chars(at, end, tick);
    if (error != std::errc{}) return std::nullopt;
    at = stop;
  }
  const auto [user, nice, system, idle, iowait, irq, softirq, steal] = ticks;
  CpuTicks result{0, steal};
  for (const int64_t tick : {user, nice, system, irq, softirq})
    if (__builtin_add_overflow(result.busy, tick, &result.busy)) return std::nullopt;
  return result;
}

Channel tick_channel(std::string name, Quantity quantity, std::string origin) {
  return make_channel(std::move(name), quantity, Unit::clock_tick, Kind::cumulative,
                      std::move(origin));
}

class ProcStatSource final : public SensorSource {
 public:
  explicit ProcStatSource(TextFile file)
      : SensorSource(
            "proc_stat", 10 * ns_per_ms,
            {tick_channel("proc.stat.steal", Quantity::interference, file.path() + ": steal"),
             tick_channel("proc.stat.busy", Quantity::utilization,
                          file.path() + ": user + nice + system + irq + softirq")}),
        file_(std::move(file)) {}

  void poll(std::span<Reading> out) noexcept override {
    std::array<char, 256> buffer;
    const TextFile::Read read = file_.read(buffer);
    const std::optional<CpuTicks> ticks = parse_cpu_line(read.text);
    out[0] = read.reading(ticks ? std::optional(ticks->steal) : std::nullopt);
    out[1] = read.reading(ticks ? std::optional(ticks->busy) : std::nullopt);
  }

 private:
  TextFile file_;
};

}  // namespace

void discover_proc_stat(const Root& root, Discovery& discovery) {
  const Root::Text text = root.read(path);
  if (!text.text)
    discovery.missing.push_back(
        {"proc_stat",
         fmt::format("cannot read '{}': {}", root.display(path), errno_text(text.error)), ""});
  else if (!parse_cpu_line(*text.text))
    discovery.missing.push_back(
        {"proc_stat",
         fmt::format("'{}' does not begin with 'cpu' and eight numbers", root.display(path)), ""});
  else
    discovery.sources.push_back(std::make_unique<ProcStatSource>(TextFile(root, path)));
}

}  // namespace energyprof::probe
