// Expects in proc/self/task/<tid>/schedstat three numbers: ns on a processor, ns ready to run but
// waiting for one, number of turns.
#include "probe/schedstat.h"

#include <dirent.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cstddef>
#include <optional>
#include <string_view>
#include <utility>

#include "core/clock.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr const char* task_directory = "/proc/self/task";
constexpr const char* own_file = "/proc/thread-self/schedstat";
constexpr const char* delay_accounting = "/proc/sys/kernel/task_delayacct";
constexpr std::size_t max_thread_count = 256;
constexpr int64_t schedstat_period_ns = 5 * ns_per_ms;
constexpr int64_t new_thread_check_ns = 100 * ns_per_ms;

struct Times {
  int64_t run_ns = 0;
  int64_t wait_ns = 0;
};

// The first two numbers.
std::optional<Times> parse_times(std::string_view text) {
  Times times;
  const char* const end = text.data() + text.size();
  const auto [space, run_error] = std::from_chars(text.data(), end, times.run_ns);
  if (run_error != std::errc{} || space == end || *space != ' ') return std::nullopt;
  const auto [stop, wait_error] = std::from_chars(space + 1, end, times.wait_ns);
  if (wait_error != std::errc{}) return std::nullopt;
  return times;
}

struct Thread {
  pid_t id = 0;
  int fd = -1;
  Times times;  // as last read
};

Channel time_channel(std::string name, Quantity quantity, std::string_view what) {
  return make_channel(std::move(name), quantity, Unit::nanosecond, Kind::cumulative,
                      fmt::format("{}/*/schedstat: {}", task_directory, what));
}

class SchedstatSource final : public SensorSource {
 public:
  /// Takes the descriptor of the task directory over.
  explicit SchedstatSource(int directory)
      : SensorSource(
            "schedstat", schedstat_period_ns,
            {time_channel("process.cpu_wait", Quantity::interference, "time waiting to run"),
             time_channel("process.cpu_time", Quantity::utilization, "time running")}),
        directory_(directory) {}
  ~SchedstatSource() override {
    for (std::size_t i = 0; i < thread_count_; ++i) close(threads_[i].fd);
    close(directory_);
  }

  void poll(std::span<Reading> out) noexcept override {
    const int64_t before_ns = now_ns();
    if (before_ns >= next_check_ns_) {
      find_new_threads();
      next_check_ns_ = before_ns + new_thread_check_ns;
    }
    const auto self = static_cast<pid_t>(syscall(SYS_gettid));
    for (std::size_t i = 0; i < thread_count_;) {
      const std::optional<Times> times = read_times(threads_[i].fd);
      if (!times) {  // it ended
        close(threads_[i].fd);
        threads_[i] = threads_[--thread_count_];
        continue;
      }
      const Times& last = threads_[i].times;
      total_.run_ns += std::max<int64_t>(times->run_ns - last.run_ns, 0);
      if (threads_[i].id != self)
        total_.wait_ns += std::max<int64_t>(times->wait_ns - last.wait_ns, 0);
      threads_[i].times = *times;
      ++i;
    }
    const int64_t width_ns = now_ns() - before_ns;
    const int64_t t_ns = before_ns + width_ns / 2;
    // The thread that polls is one at least: none is a file that would not open, not a time of 0.
    const PollStatus status = thread_count_ > 0 ? PollStatus::ok : PollStatus::retry;
    out[0] = {status, t_ns, total_.wait_ns, width_ns, 0};
    out[1] = {status, t_ns, total_.run_ns, width_ns, 0};
  }

 private:
  static std::optional<Times> read_times(int fd) noexcept {
    std::array<char, 96> buffer;
    const ssize_t got = pread(fd, buffer.data(), buffer.size(), 0);
    if (got <= 0) return std::nullopt;
    return parse_times({buffer.data(), static_cast<std::size_t>(got)});
  }

  // By system calls of its own: readdir() allocates.
  void find_new_threads() noexcept {
    struct Entry {  // struct linux_dirent64
      uint64_t inode;
      int64_t offset;
      uint16_t byte_count;
      unsigned char type;
      char name[1];
    };
    constexpr std::size_t name_offset = offsetof(Entry, name);
    if (lseek(directory_, 0, SEEK_SET) != 0) return;
    alignas(Entry) std::array<char, 2048> buffer;
    for (long got = 0;
         (got = syscall(SYS_getdents64, directory_, buffer.data(), buffer.size())) > 0;) {
      for (long at = 0; at < got;) {
        const auto* entry = reinterpret_cast<const Entry*>(buffer.data() + at);
        add(std::string_view(buffer.data() + at + name_offset));
        at += entry->byte_count;
      }
    }
    is_first_look_ = false;
  }

  void add(std::string_view name) noexcept {
    pid_t id = 0;
    const auto [stop, error] = std::from_chars(name.data(), name.data() + name.size(), id);
    if (error != std::errc{} || stop != name.data() + name.size()) return;  // "." and ".."
    const auto known = threads_.begin() + static_cast<std::ptrdiff_t>(thread_count_);
    if (std::any_of(threads_.begin(), known, [&](const Thread& t) { return t.id == id; })) return;
    if (thread_count_ == max_thread_count) return;
    std::array<char, 64> path{};
    fmt::format_to_n(path.data(), path.size() - 1, "{}/{}/schedstat", task_directory, id);
    const int fd = open(path.data(), O_RDONLY | O_CLOEXEC);
    if (fd < 0) return;
    // What a thread did before the first poll is not this run's; later ones are from it.
    threads_[thread_count_++] = {id, fd,
                                 is_first_look_ ? read_times(fd).value_or(Times{}) : Times{}};
  }

  int directory_;
  std::array<Thread, max_thread_count> threads_;
  std::size_t thread_count_ = 0;
  int64_t next_check_ns_ = 0;
  Times total_;
  bool is_first_look_ = true;
};

}  // namespace

void discover_schedstat(const Root& root, const Selection& selection, Discovery& discovery) {
  if (selection.program) {
    discovery.missing.push_back(
        {"schedstat", "it tells of energyprof itself, not of the program that is recorded", ""});
    return;
  }
  const auto miss = [&](std::string reason, std::string fix = {}) {
    discovery.missing.push_back({"schedstat", std::move(reason), std::move(fix)});
  };
  const Root::Text text = root.read(own_file);
  if (!text.text)
    return miss(fmt::format("cannot read '{}': {}", own_file, errno_text(text.error)));
  const std::optional<Times> own = parse_times(*text.text);
  if (!own) return miss(fmt::format("'{}' does not begin with two numbers", own_file));
  // The thread that reads it has run. Kernels without CONFIG_SCHEDSTATS count only where delay
  // accounting is on, and write zeros otherwise.
  if (own->run_ns == 0)
    return miss(
        fmt::format("'{}' is 0 for a thread that runs: the kernel does not count", own_file),
        root.exists(delay_accounting) ? "sudo sysctl kernel.task_delayacct=1" : "");
  const int directory = open(task_directory, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (directory < 0)
    return miss(fmt::format("cannot open '{}': {}", task_directory, errno_text(errno)));
  discovery.sources.push_back(std::make_unique<SchedstatSource>(directory));
}

}  // namespace energyprof::probe
