// What getrusage() knows of this process: it asks for no permission.
#include <sys/resource.h>

#include <utility>

#include "core/clock.h"
#include "probe/perf_events.h"

namespace energyprof::probe {
namespace {

Channel usage_channel(std::string name, std::string origin) {
  return make_channel(std::move(name), Quantity::interference, Unit::count, Kind::cumulative,
                      std::move(origin));
}

class UsageSource final : public SensorSource {
 public:
  UsageSource()
      : SensorSource("perf", 10 * ns_per_ms,
                     {usage_channel("process.context_switches", "getrusage: ru_nvcsw + ru_nivcsw"),
                      usage_channel("process.page_faults", "getrusage: ru_minflt + ru_majflt")}) {}

  void poll(std::span<Reading> out) noexcept override {
    rusage usage{};
    const int64_t before_ns = now_ns();
    getrusage(RUSAGE_SELF, &usage);
    const int64_t width_ns = now_ns() - before_ns;
    const int64_t t_ns = before_ns + width_ns / 2;
    out[0] = {PollStatus::ok, t_ns, usage.ru_nvcsw + usage.ru_nivcsw, width_ns, 0};
    out[1] = {PollStatus::ok, t_ns, usage.ru_minflt + usage.ru_majflt, width_ns, 0};
  }
};

}  // namespace

void add_process_usage(const Selection& selection, Discovery& discovery) {
  if (selection.program)
    discovery.missing.push_back(
        {"perf", "getrusage tells of energyprof itself, not of the program that is recorded", ""});
  else
    discovery.sources.push_back(std::make_unique<UsageSource>());
}

}  // namespace energyprof::probe
