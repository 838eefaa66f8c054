// What any Linux machine has, for real: quotas, pressure, stolen time and software events move as
// they should under a load that the test makes.
#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>
#include <thread>

#include "core/clock.h"
#include "probe/cgroup.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

Discovery find(const std::string& source) {
  return discover(Root(), Selection{.sources = {source}});
}

// Why there is no such channel here, for a test that has to be skipped.
std::string reason_of(const Discovery& found) {
  return found.missing.empty() ? "not found" : found.missing.front().reason;
}

int64_t cpu_time_ns() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return time.tv_sec * ns_per_s + time.tv_nsec;
}

// Keeps a processor busy for this much of the calling thread's own CPU time.
void spin(int64_t duration_ns) {
  for (const int64_t end_ns = cpu_time_ns() + duration_ns; cpu_time_ns() < end_ns;) continue;
}

// What is asked of a loaded machine comes late, but it comes.
constexpr int64_t patience_ns = 60 * ns_per_s;

bool write_text(const std::filesystem::path& file, const std::string& text) {
  std::ofstream out(file);
  out << text << std::flush;
  return out.good();
}

// A fresh control group for CPU time, removed again.
class Group {
 public:
  // Below the first directory where one with the cpu controller can be made; what() says why not.
  Group() {
    const std::string name = fmt::format("energyprof-test-{}-{}", getpid(), ++count_);
    std::vector<std::string> parents{"/sys/fs/cgroup/cpu", "/sys/fs/cgroup/cpu,cpuacct"};
    if (const auto own = own_group_v2(Root()))
      for (std::filesystem::path path = "/" + *own; path.string().starts_with("/sys/fs/cgroup");
           path = path.parent_path())
        parents.push_back(path);
    for (const std::string& parent : parents) {
      std::error_code error;
      if (!std::filesystem::is_directory(parent, error)) continue;
      const std::filesystem::path path = std::filesystem::path(parent) / name;
      if (!std::filesystem::create_directory(path, error)) {
        what_ += fmt::format("cannot make a group in '{}': {}. ", parent, error.message());
        continue;
      }
      path_ = path;
      is_v1_ = std::filesystem::exists(path / "cpu.cfs_quota_us");
      if ((is_v1_ || std::filesystem::exists(path / "cpu.max")) && set_no_quota()) return;
      what_ += fmt::format("'{}' has no cpu controller for groups. ", parent);
      remove();
    }
  }
  ~Group() { remove(); }
  Group(const Group&) = delete;
  Group& operator=(const Group&) = delete;

  [[nodiscard]] bool exists() const { return !path_.empty(); }
  [[nodiscard]] const std::string& what() const { return what_; }

  [[nodiscard]] bool set_no_quota() const {
    return is_v1_ ? write_text(path_ / "cpu.cfs_quota_us", "-1")
                  : write_text(path_ / "cpu.max", "max 100000");
  }
  // The share of one CPU, in thousandths.
  [[nodiscard]] bool set_quota(int permille) const {
    const std::string quota_us = std::to_string(100 * permille);
    return is_v1_ ? write_text(path_ / "cpu.cfs_period_us", "100000") &&
                        write_text(path_ / "cpu.cfs_quota_us", quota_us)
                  : write_text(path_ / "cpu.max", quota_us + " 100000");
  }
  [[nodiscard]] bool enter() const { return write_text(path_ / "cgroup.procs", "0"); }

 private:
  void remove() {
    if (path_.empty()) return;
    // A process that has just ended may still be in it.
    for (const int64_t end_ns = now_ns() + 5 * ns_per_s; now_ns() < end_ns;) {
      if (rmdir(path_.c_str()) == 0 || errno != EBUSY) break;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    path_.clear();
  }

  static inline int count_ = 0;
  std::filesystem::path path_;
  bool is_v1_ = false;
  std::string what_;
};

// Runs `work` in a child process, which ends with this one; what it returns comes back as text.
template <class Work>
std::optional<std::string> in_child(const Work& work) {
  int ends[2] = {};
  if (pipe2(ends, O_CLOEXEC) != 0) return std::nullopt;
  const pid_t child = fork();
  if (child == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    const std::string text = work();
    const bool written = write(ends[1], text.data(), text.size()) == ssize_t(text.size());
    _exit(written ? 0 : 1);
  }
  close(ends[1]);
  std::string text;
  char chunk[4096];
  for (ssize_t got = 0; (got = read(ends[0], chunk, sizeof chunk)) > 0;)
    text.append(chunk, static_cast<size_t>(got));
  close(ends[0]);
  int status = 0;
  if (child < 0 || waitpid(child, &status, 0) != child || status != 0) return std::nullopt;
  return text;
}

// What a process in the group sees of its own throttling while it spins: "periods time", until
// `is_enough` of them; or why it does not.
template <class IsEnough>
std::string throttled_in(const Group& group, const IsEnough& is_enough) {
  if (!group.enter()) return "cannot enter the group";
  const Discovery found = find("cgroup");
  if (channel_called(found, "cgroup.cpu.throttled").id == 0) return reason_of(found);
  auto before = poll_all(found);
  int64_t periods = 0;
  int64_t time = 0;
  const int64_t end_ns = now_ns() + patience_ns;
  do {
    spin(10 * ns_per_ms);
    auto after = poll_all(found);
    const auto rise = [&](const char* name) { return after[name].value - before[name].value; };
    periods = rise("cgroup.cpu.throttled_periods");
    time = rise("cgroup.cpu.throttled");
  } while (!is_enough(periods, time) && now_ns() < end_ns);
  return fmt::format("{} {}", periods, time);
}

TEST(Live, AProcessWithAQuotaSeesHowItIsStopped) {
  const Group group;
  if (!group.exists()) GTEST_SKIP() << group.what();
  ASSERT_TRUE(group.set_quota(50));
  const auto text = in_child([&] {
    return throttled_in(group,
                        [](int64_t periods, int64_t time) { return periods > 1 && time > 0; });
  });
  ASSERT_TRUE(text.has_value());
  int64_t periods = 0;
  int64_t time = 0;
  ASSERT_TRUE(std::istringstream(*text) >> periods >> time) << *text;
  EXPECT_GT(periods, 1);
  EXPECT_GT(time, 0);
}

TEST(Live, AProcessWithoutAQuotaIsNotStopped) {
  const Group group;
  if (!group.exists()) GTEST_SKIP() << group.what();
  // Ten times what the one with the quota may use in a period.
  int rounds = 0;
  const auto text = in_child(
      [&] { return throttled_in(group, [&](int64_t, int64_t) { return ++rounds == 5; }); });
  EXPECT_EQ(text, "0 0");
}

TEST(Live, PressureRisesWithMoreThreadsThanProcessors) {
  const Discovery found = find("psi");
  const std::string name = "psi.cpu.some";
  if (channel_called(found, name).id == 0) GTEST_SKIP() << reason_of(found);
  const int64_t before_us = poll_all(found)[name].value;
  std::atomic<bool> stop = false;
  std::vector<std::jthread> threads;
  for (unsigned i = 0; i < 2 * std::max(1u, std::thread::hardware_concurrency()); ++i)
    threads.emplace_back([&] {
      while (!stop) continue;
    });
  constexpr int64_t wanted_us = 20'000;
  int64_t rise_us = 0;
  for (const int64_t end_ns = now_ns() + patience_ns; rise_us < wanted_us && now_ns() < end_ns;) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    const Reading reading = poll_all(found)[name];
    EXPECT_EQ(reading.status, PollStatus::ok);
    rise_us = reading.value - before_us;
  }
  stop = true;
  EXPECT_GE(rise_us, wanted_us);
}

TEST(Live, WaitingForAProcessorIsCountedForEveryThread) {
  const Discovery found = find("schedstat");
  const std::string name = "process.cpu_wait";
  if (channel_called(found, name).id == 0) GTEST_SKIP() << reason_of(found);
  const int64_t before_ns = poll_all(found)[name].value;
  std::atomic<bool> stop = false;
  std::vector<std::jthread> threads;  // begin after the first poll
  for (unsigned i = 0; i < 2 * std::max(1u, std::thread::hardware_concurrency()); ++i)
    threads.emplace_back([&] {
      while (!stop) continue;
    });
  int64_t last_ns = before_ns;
  constexpr int64_t wanted_ns = 200 * ns_per_ms;
  for (const int64_t end_ns = now_ns() + patience_ns;
       last_ns - before_ns < wanted_ns && now_ns() < end_ns;) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    const Reading reading = poll_all(found)[name];
    EXPECT_EQ(reading.status, PollStatus::ok);
    EXPECT_GE(reading.value, last_ns);
    last_ns = reading.value;
  }
  stop = true;
  EXPECT_GE(last_ns - before_ns, wanted_ns);
  threads.clear();
  // Threads that ended take nothing of the sum with them.
  EXPECT_GE(poll_all(found)[name].value, last_ns);
}

TEST(Live, TimeOnAProcessorIsCountedForEveryThread) {
  const Discovery found = find("schedstat");
  const std::string name = "process.cpu_time";
  if (channel_called(found, name).id == 0) GTEST_SKIP() << reason_of(found);
  rusage usage{};
  const auto used_ns = [&usage] {
    getrusage(RUSAGE_SELF, &usage);
    int64_t sum_us = 0;
    for (const timeval& time : {usage.ru_utime, usage.ru_stime})
      sum_us += time.tv_sec * 1'000'000 + time.tv_usec;
    return sum_us * 1000;
  };
  const int64_t before_ns = poll_all(found)[name].value;
  const int64_t used_before_ns = used_ns();
  std::atomic<bool> stop = false;
  const std::jthread other([&] {
    while (!stop) continue;
  });
  spin(300 * ns_per_ms);
  const int64_t used_after_ns = used_ns();
  // What ended between two polls is not seen: so the other one is polled while it is there.
  const int64_t rise_ns = poll_all(found)[name].value - before_ns;
  stop = true;
  // Of a thread that runs the kernel tells what it had at its last tick.
  constexpr int64_t slack_ns = 30 * ns_per_ms;
  EXPECT_GE(rise_ns, used_after_ns - used_before_ns - slack_ns);
  EXPECT_LE(rise_ns, used_ns() - used_before_ns + slack_ns);
}

// The n-th number of the first line of /proc/stat, from 1.
int64_t stat_ticks(int n) {
  std::ifstream file("/proc/stat");
  std::string word;
  for (int i = 0; i <= n; ++i) file >> word;
  return std::stoll(word);
}

TEST(Live, BusyAndStolenTimeAreTheKernels) {
  const Discovery found = find("proc_stat");
  if (channel_called(found, "proc.stat.steal").id == 0) GTEST_SKIP() << reason_of(found);
  const int64_t steal_before = stat_ticks(8);
  auto before = poll_all(found);
  // Seen from inside, time that the host takes away may count as used.
  constexpr int64_t used_ns = 300 * ns_per_ms;
  spin(used_ns);
  auto after = poll_all(found);
  const int64_t steal_after = stat_ticks(8);
  const auto rise = [&](const char* name) { return after[name].value - before[name].value; };
  const int64_t used_ticks = used_ns * sysconf(_SC_CLK_TCK) / ns_per_s;
  EXPECT_GE(rise("proc.stat.busy") + rise("proc.stat.steal"), used_ticks / 2);
  // The kernel may take back a few ticks.
  constexpr int64_t slack = 3;
  EXPECT_GE(after["proc.stat.steal"].value, steal_before - slack);
  EXPECT_LE(after["proc.stat.steal"].value, steal_after + slack);
}

TEST(Live, SoftwareEventsCountAtLeastWhatAChildDid) {
  const Discovery found = find("perf");
  const bool sees_switches = channel_called(found, "perf.context_switches").id != 0;
  const bool sees_faults = channel_called(found, "perf.page_faults").id != 0;
  if (!sees_switches && !sees_faults) GTEST_SKIP() << reason_of(found);
  auto before = poll_all(found);
  constexpr size_t page_count = 256;
  constexpr int nap_count = 50;
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    const auto page_bytes = static_cast<size_t>(sysconf(_SC_PAGESIZE));
    void* const memory = mmap(nullptr, page_count * page_bytes, PROT_READ | PROT_WRITE,
                              MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (memory == MAP_FAILED) _exit(1);
    madvise(memory, page_count * page_bytes, MADV_NOHUGEPAGE);
    for (size_t page = 0; page < page_count; ++page)
      static_cast<volatile char*>(memory)[page * page_bytes] = 1;
    for (int nap = 0; nap < nap_count; ++nap) usleep(100);
    _exit(0);
  }
  int status = 0;
  rusage usage{};
  ASSERT_EQ(wait4(child, &status, 0, &usage), child);
  ASSERT_EQ(status, 0);
  ASSERT_GE(usage.ru_nvcsw, nap_count);
  auto after = poll_all(found);
  const auto rise = [&](const char* name) { return after[name].value - before[name].value; };
  if (sees_faults) {
    EXPECT_GE(rise("perf.page_faults"), int64_t{page_count});
  }
  if (sees_switches) {
    EXPECT_GE(rise("perf.context_switches"), int64_t{nap_count});
  }
}

}  // namespace
}  // namespace energyprof::probe
