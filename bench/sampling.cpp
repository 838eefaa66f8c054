// What sampling costs beside a load that keeps every processor busy, and beside it, in the same run
// and on the same files, what a shell loop and `perf stat -I` take for a sample:
//
//   sampling_bench tests/data/sysfs/intel-rplp-i915-laptop 10 [COMMAND...]
//
// The machine's files are copied to tmpfs and read there. The load is the command, or one spinning
// thread for each processor.
#include <fmt/format.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>
#include <vector>

#include "core/clock.h"
#include "probe/characterize.h"
#include "probe/discover.h"
#include "probe/sampler.h"

namespace fs = std::filesystem;
namespace probe = energyprof::probe;

namespace {

constexpr size_t channel_limit = 40;
constexpr double tick_rate_hz = 1000.0;

/// Starts a command that says nothing. Call it before there are threads that hold locks.
pid_t start(const std::vector<std::string>& command) {
  std::fflush(stdout);
  const pid_t child = fork();
  if (child != 0) return child;
  if (freopen("/dev/null", "w", stdout) == nullptr) _exit(126);
  if (freopen("/dev/null", "w", stderr) == nullptr) _exit(126);
  std::vector<char*> argv;
  for (const std::string& word : command) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  execvp(argv[0], argv.data());
  _exit(127);
}

/// Keeps every processor busy while it lives.
class Load {
 public:
  /// By a command, or without one by spinning.
  explicit Load(const std::vector<std::string>& command) {
    if (!command.empty()) {
      child_ = start(command);
      std::this_thread::sleep_for(std::chrono::seconds(3));  // until it is at work
      return;
    }
    for (unsigned i = 0; i < std::thread::hardware_concurrency(); ++i)
      threads_.emplace_back([this] {
        while (!stop_.load(std::memory_order_relaxed)) {
        }
      });
  }
  ~Load() {
    stop_ = true;
    for (std::thread& thread : threads_) thread.join();
    if (child_ <= 0) return;
    if (waitpid(child_, nullptr, WNOHANG) != 0) {
      fmt::print("The load ended before the measurement did.\n");
      return;
    }
    kill(child_, SIGKILL);
    waitpid(child_, nullptr, 0);
  }
  Load(const Load&) = delete;
  Load& operator=(const Load&) = delete;

 private:
  std::atomic<bool> stop_{false};
  std::vector<std::thread> threads_;
  pid_t child_ = 0;
};

/// A copy of a machine's directory on tmpfs.
class Copy {
 public:
  explicit Copy(const fs::path& machine) {
    std::string name = "/dev/shm/energyprof-bench-XXXXXX";
    directory_ = mkdtemp(name.data());
    fs::copy(machine, directory_,
             fs::copy_options::recursive | fs::copy_options::overwrite_existing);
  }
  ~Copy() { fs::remove_all(directory_); }
  Copy(const Copy&) = delete;
  Copy& operator=(const Copy&) = delete;
  [[nodiscard]] const std::string& directory() const { return directory_; }

 private:
  std::string directory_;
};

/// CPU time of a command that is run for some seconds, then interrupted.
int64_t cpu_ns_of(const std::vector<std::string>& command, double seconds) {
  const pid_t child = start(command);
  std::this_thread::sleep_for(std::chrono::duration<double>(seconds));
  kill(child, SIGINT);
  int status = 0;
  rusage usage{};
  wait4(child, &status, 0, &usage);
  if (WIFEXITED(status) && WEXITSTATUS(status) == 127) return 0;
  const auto ns = [](const timeval& time) {
    return int64_t{time.tv_sec} * energyprof::ns_per_s + time.tv_usec * energyprof::ns_per_us;
  };
  return ns(usage.ru_utime) + ns(usage.ru_stime);
}

void print_row(const std::string& who, double per_sample_us, double samples_per_s, double ours_us) {
  fmt::print("| {:<58} | {:>9.2f} | {:>9.0f} | {:>6.1f} |\n", who, per_sample_us, samples_per_s,
             per_sample_us / ours_us);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    fmt::print(stderr, "usage: sampling_bench MACHINE [SECONDS [COMMAND...]]\n");
    return 2;
  }
  const double seconds = argc > 2 ? std::atof(argv[2]) : 10.0;
  const Copy copy(argv[1]);
  const probe::Root root(copy.directory());
  probe::Discovery found = probe::discover(root);
  size_t channel_count = 0;
  std::erase_if(found.sources, [&](const auto& source) {
    const size_t count = source->channels().size();
    if (channel_count + count > channel_limit) return true;
    channel_count += count;
    return false;
  });
  probe::characterize(found, root, {energyprof::ns_per_ms, energyprof::ns_per_ms});

  probe::Sampler::Config config;
  config.rate_hz = tick_rate_hz;
  probe::Sampler sampler(found.sources, config);
  probe::Sampler::Stats stats;
  const Load load(argc > 3 ? std::vector<std::string>(argv + 3, argv + argc)
                           : std::vector<std::string>{});
  {
    std::vector<energyprof::Sample> samples;
    samples.reserve(size_t{1} << 20);
    sampler.start();
    const int64_t end_ns = energyprof::now_ns() + static_cast<int64_t>(seconds * 1e9);
    while (energyprof::now_ns() < end_ns) {
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
      samples.clear();
      sampler.drain(samples);
    }
    sampler.stop();
    stats = sampler.stats();
  }
  const double ours_us =
      static_cast<double>(stats.cpu_ns) * 1e-3 / static_cast<double>(stats.sample_count);
  fmt::print("{} channels of {}, ticks of {} Hz, every processor busy, {}\n", channel_count,
             fs::path(argv[1]).filename().string(), tick_rate_hz, stats.scheduling);
  fmt::print(
      "CPU: {:.2f} % of one core, {:.1f} us a tick; {} of {} ticks missed; lateness median "
      "{:.0f} us, 99 % below {:.0f} us, worst {:.1f} ms\n\n",
      static_cast<double>(stats.cpu_ns) * 1e-7 / seconds,
      static_cast<double>(stats.cpu_ns) * 1e-3 / static_cast<double>(stats.tick_count),
      stats.missed_tick_count, stats.tick_count + stats.missed_tick_count,
      static_cast<double>(stats.lateness_p50_ns.value_or(0)) * 1e-3,
      static_cast<double>(stats.lateness_p99_ns.value_or(0)) * 1e-3,
      static_cast<double>(stats.lateness_max_ns.value_or(0)) * 1e-6);

  fmt::print("| {:<58} | us/sample | samples/s | ratio  |\n|---|---|---|---|\n", "who");
  print_row("energyprof", ours_us, static_cast<double>(stats.sample_count) / seconds, ours_us);

  // The shell reads the same files as often as it can and says how often that was.
  std::string list;
  size_t file_count = 0;
  for (const auto& source : found.sources)
    for (const energyprof::Channel& channel : source->channels()) {
      // Links of the machine's directory may be text files.
      const std::string file =
          root.resolve(channel.origin.substr(copy.directory().size() + 1)).path;
      if (!fs::is_regular_file(file)) continue;
      list += ' ' + file;
      ++file_count;
    }
  const std::string count_file = copy.directory() + "/rounds";
  const std::string loop = fmt::format(
      "n=0; trap 'echo $n > {}; exit' INT; while :; do for f in{}; do read -r v < $f; done; "
      "n=$((n+1)); done",
      count_file, list);
  const int64_t shell_cpu_ns = cpu_ns_of({"sh", "-c", loop}, seconds);
  double rounds = 0;
  std::ifstream(count_file) >> rounds;
  if (rounds > 0) {
    const double samples = rounds * static_cast<double>(file_count);
    print_row("sh: while :; do read -r v < FILE ...; done, the same files",
              static_cast<double>(shell_cpu_ns) * 1e-3 / samples, samples / seconds, ours_us);
  }

  const std::string events = "context-switches,cpu-migrations,page-faults,major-faults";
  for (const int interval_ms : {10, 100}) {
    const int64_t perf_cpu_ns =
        cpu_ns_of({"perf", "stat", "-a", "-I", std::to_string(interval_ms), "-e", events}, seconds);
    const double samples = 4 * seconds * 1000 / interval_ms;
    if (perf_cpu_ns == 0)
      fmt::print("perf is not installed\n");
    else
      print_row(fmt::format("perf stat -a -I {} -e {}", interval_ms, events),
                static_cast<double>(perf_cpu_ns) * 1e-3 / samples, samples / seconds, ours_us);
  }
  return 0;
}
