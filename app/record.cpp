#include "app/record.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <stdexcept>

#include "app/config.h"
#include "app/host.h"
#include "app/results.h"
#include "app/sensors.h"
#include "app/study.h"
#include "core/clock.h"
#include "core/run_db.h"

namespace energyprof::app {
namespace {

namespace fs = std::filesystem;

constexpr int exit_not_found = 127;
constexpr int exit_not_executable = 126;

std::atomic<pid_t> child{0};

/// Passes on what was sent to this process alone. The terminal's Ctrl-C and its kin reach the whole
/// process group, the child included: once is enough.
void forward(int signal, siginfo_t* info, void*) {
  const bool sent_by_a_process =
      info->si_code == SI_USER || info->si_code == SI_QUEUE || info->si_code == SI_TKILL;
  const pid_t pid = child.load();
  if (sent_by_a_process && pid > 0) kill(pid, signal);
}

/// Signals are forwarded while it lives, so that none of them ends the recording before the
/// program.
class Forwarding {
 public:
  Forwarding() {
    struct sigaction action {};
    action.sa_sigaction = forward;
    action.sa_flags = SA_SIGINFO | SA_RESTART;
    for (size_t i = 0; i < signals.size(); ++i) sigaction(signals[i], &action, &before_[i]);
  }
  ~Forwarding() {
    for (size_t i = 0; i < signals.size(); ++i) sigaction(signals[i], &before_[i], nullptr);
  }
  Forwarding(const Forwarding&) = delete;
  Forwarding& operator=(const Forwarding&) = delete;

  static constexpr std::array signals{SIGINT,  SIGTERM, SIGHUP,  SIGQUIT,
                                      SIGUSR1, SIGUSR2, SIGALRM, SIGWINCH};

 private:
  std::array<struct sigaction, signals.size()> before_{};
};

/// Starts the command with signals as this process found them. Returns errno.
int spawn(const std::vector<std::string>& command, pid_t& pid) {
  std::vector<char*> argv;
  for (const std::string& word : command) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  sigset_t defaults;
  sigemptyset(&defaults);
  for (const int signal : Forwarding::signals) sigaddset(&defaults, signal);
  posix_spawnattr_setsigdefault(&attributes, &defaults);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGDEF);
  const int error = posix_spawnp(&pid, argv[0], nullptr, &attributes, argv.data(), environ);
  posix_spawnattr_destroy(&attributes);
  return error;
}

int wait_for(pid_t pid) {
  int status = 0;
  while (waitpid(pid, &status, 0) < 0 && errno == EINTR) {
  }
  return status;
}

std::string ending_of(int status) {
  return WIFSIGNALED(status) ? fmt::format("was ended by signal {} ({})", WTERMSIG(status),
                                           strsignal(WTERMSIG(status)))
                             : fmt::format("ended with exit code {}", WEXITSTATUS(status));
}

/// Nothing was run: nothing is left.
void remove_run(const fs::path& dir) {
  std::error_code ignored;
  for (const char* name : {"run.sqlite", "run.sqlite-wal", "run.sqlite-shm", "images"})
    fs::remove(dir / name, ignored);
  fs::remove(dir, ignored);
}

void record_meta(RunWriter& writer, const RecordOptions& options, const std::string& name,
                 const Sensors& sensors) {
  writer.set_meta("name", name);
  writer.set_meta("question", "what does this program cost?");
  writer.set_meta("command", fmt::format("{}", fmt::join(options.command, " ")));
  writer.set_meta("host", describe_host().dump());
  writer.set_meta("code_version", ENERGYPROF_VERSION);
  writer.set_meta("build_type", ENERGYPROF_BUILD_TYPE);
  writer.set_meta("begin_ns", std::to_string(now_ns()));
  writer.set_meta("begin_utc", utc_now());
  writer.set_meta("interrupted", "0");
  writer.set_meta("simulated", options.root == "/" ? "0" : "1");
  writer.set_meta("missing_sensors", sensors.missing_json().dump());
  writer.set_meta("verdict", sensors.verdict());
}

}  // namespace

int record_command(const RecordOptions& options) {
  const std::string name = fs::path(options.command.front()).filename().string();
  const fs::path dir = options.out.empty() ? default_run_dir(name) : fs::path(options.out);
  Config config;
  config.sampler_rate_hz = options.rate_hz;
  // Before any thread: the command inherits the counters of the thread that starts it.
  Sensors sensors(options.root, config, options.allow_msr);
  create_run_dir(dir);
  std::error_code ignored;
  fs::remove(dir / "images", ignored);  // there are no frames to picture

  int status = 0;
  {
    RunWriter::Config writer_config;
    writer_config.pull_samples = [&](std::vector<Sample>& out) { sensors.drain(out); };
    RunWriter writer(dir / "run.sqlite", std::move(writer_config));
    for (const Channel& channel : sensors.channels()) writer.add_channel(channel);
    record_meta(writer, options, name, sensors);
    sensors.start();
    const Forwarding forwarding;
    const int64_t begin_ns = now_ns();
    pid_t pid = 0;
    if (const int error = spawn(options.command, pid); error != 0) {
      sensors.stop();
      writer.close();
      remove_run(dir);
      fmt::print(stderr, "energyprof: cannot run '{}': {}.\n", options.command.front(),
                 std::strerror(error));
      return error == ENOENT ? exit_not_found : exit_not_executable;
    }
    child = pid;
    status = wait_for(pid);
    child = 0;
    const int64_t end_ns = now_ns();
    sensors.stop();
    for (Event& event : sensors.drain_events()) writer.add_event(std::move(event));
    writer.add_event({begin_ns, end_ns, Severity::info, "command", std::nullopt,
                      fmt::format("'{}' {}", fmt::join(options.command, " "), ending_of(status))});
    for (const auto& [key, value] : sensors.cost_meta()) writer.set_meta(key, value);
    writer.set_meta("command_begin_ns", std::to_string(begin_ns));
    writer.set_meta("command_end_ns", std::to_string(end_ns));
    writer.set_meta("end_ns", std::to_string(now_ns()));
    writer.close();
  }
  std::FILE* const to = options.quiet ? std::fopen("/dev/null", "w") : stderr;
  if (to == nullptr) throw std::runtime_error("cannot open '/dev/null' to be quiet.");
  write_all_reports(dir, dir / "run.sqlite", to);
  if (to != stderr) std::fclose(to);
  return WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
}

}  // namespace energyprof::app
