// perf_event_open(2) of events by their libpfm4 name, one descriptor each.
#include "probe/perf_events.h"

#include <fmt/format.h>
#include <perfmon/pfmlib_perf_event.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

#include "core/clock.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

struct SoftwareEvent {
  const char* pfm_name;
  std::string_view channel_name;
  bool only_in_kernel;  // happens in kernel mode: would count 0 when that is excluded
};
constexpr std::array events{
    SoftwareEvent{"perf::PERF_COUNT_SW_CONTEXT_SWITCHES", "perf.context_switches", true},
    SoftwareEvent{"perf::PERF_COUNT_SW_CPU_MIGRATIONS", "perf.cpu_migrations", true},
    SoftwareEvent{"perf::PERF_COUNT_SW_PAGE_FAULTS", "perf.page_faults", false},
    SoftwareEvent{"perf::PERF_COUNT_SW_PAGE_FAULTS_MAJ", "perf.major_faults", false},
};

// Reading interrupts every CPU that runs a counted thread, once per event: not at every tick.
constexpr int64_t perf_period_ns = 10 * ns_per_ms;

class Counter {
 public:
  explicit Counter(int fd) : fd_(fd) {}
  ~Counter() {
    if (fd_ >= 0) close(fd_);
  }
  Counter(Counter&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Counter& operator=(Counter&&) = delete;

  Reading read() noexcept {
    uint64_t count = 0;
    const int64_t before_ns = now_ns();
    const ssize_t got = ::read(fd_, &count, sizeof count);
    const int error = got < 0 ? errno : 0;
    const int64_t width_ns = now_ns() - before_ns;
    const int64_t t_ns = before_ns + width_ns / 2;
    if (error == 0 && got != sizeof count) return {PollStatus::gone, t_ns, 0, width_ns, error};
    return {status_of(error), t_ns, static_cast<int64_t>(count), width_ns, error};
  }

 private:
  int fd_;
};

class PerfSource final : public SensorSource {
 public:
  PerfSource(std::vector<Channel> channels, std::vector<Counter> counters)
      : SensorSource("perf", perf_period_ns, std::move(channels)), counters_(std::move(counters)) {}

  void poll(std::span<Reading> out) noexcept override {
    for (size_t i = 0; i < counters_.size(); ++i) out[i] = counters_[i].read();
  }

 private:
  std::vector<Counter> counters_;
};

// The descriptor, or -errno.
int open_event(perf_event_attr attr, bool exclude_kernel) {
  attr.exclude_kernel = exclude_kernel ? 1 : 0;
  attr.exclude_hv = 1;
  attr.inherit = 1;
  const long fd = syscall(SYS_perf_event_open, &attr, 0, -1, -1, PERF_FLAG_FD_CLOEXEC);
  return fd < 0 ? -errno : static_cast<int>(fd);
}

bool is_refusal(int error) { return error == EACCES || error == EPERM; }

// What the kernel would not open, at which level of mistrust, and how to change that.
struct Refusal {
  std::string names;
  std::string why;
  bool only_in_kernel = false;  // all of them
};

Missing explain(const Root& root, const Refusal& refusal) {
  const std::string paranoid =
      root.read_line("proc/sys/kernel/perf_event_paranoid").value_or("unknown");
  Missing missing{"perf",
                  fmt::format("cannot count {}: {}; kernel.perf_event_paranoid is {}",
                              refusal.names, refusal.why, paranoid),
                  "sudo sysctl kernel.perf_event_paranoid=1"};
  // The kernel would allow it at this level: then a container's system call filter does not.
  if (parse_int(paranoid).value_or(3) <= (refusal.only_in_kernel ? 1 : 2))
    missing.fix = "docker run --cap-add PERFMON ...";
  return missing;
}

}  // namespace

void discover_perf_events(const Root& root, Discovery& discovery) {
  if (const int result = pfm_initialize(); result != PFM_SUCCESS) {
    discovery.missing.push_back(
        {"perf", fmt::format("libpfm4 does not start: {}", pfm_strerror(result)), ""});
    return;
  }
  std::vector<Channel> channels;
  std::vector<Counter> counters;
  Refusal refusal;
  for (const SoftwareEvent& event : events) {
    perf_event_attr attr{};
    attr.size = sizeof attr;
    pfm_perf_encode_arg_t encoding{};
    encoding.size = sizeof encoding;
    encoding.attr = &attr;
    const int result = pfm_get_os_event_encoding(event.pfm_name, PFM_PLM0 | PFM_PLM3,
                                                 PFM_OS_PERF_EVENT, &encoding);
    if (result != PFM_SUCCESS) {
      discovery.missing.push_back(
          {"perf",
           fmt::format("libpfm4 does not know '{}': {}", event.pfm_name, pfm_strerror(result)),
           ""});
      continue;
    }
    bool user_only = false;
    int fd = open_event(attr, false);
    if (is_refusal(-fd)) {
      user_only = true;
      fd = event.only_in_kernel ? fd : open_event(attr, true);
    }
    if (fd < 0) {
      const std::string why = errno_text(-fd);
      if (is_refusal(-fd)) {
        refusal.only_in_kernel =
            event.only_in_kernel && (refusal.names.empty() || refusal.only_in_kernel);
        refusal.names += fmt::format("{}'{}'", refusal.names.empty() ? "" : ", ", event.pfm_name);
        refusal.why = why;
      } else {
        discovery.missing.push_back(
            {"perf", fmt::format("cannot count '{}': {}", event.pfm_name, why), ""});
      }
      continue;
    }
    Channel channel;
    channel.name = event.channel_name;
    channel.quantity = Quantity::interference;
    channel.unit = Unit::count;
    channel.kind = Kind::cumulative;
    channel.origin = fmt::format("{}{}", event.pfm_name, user_only ? ", user mode only" : "");
    channels.push_back(std::move(channel));
    counters.emplace_back(fd);
  }
  if (!refusal.names.empty()) discovery.missing.push_back(explain(root, refusal));
  if (!channels.empty())
    discovery.sources.push_back(
        std::make_unique<PerfSource>(std::move(channels), std::move(counters)));
}

}  // namespace energyprof::probe
