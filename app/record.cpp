#include "app/record.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cstring>
#include <filesystem>
#include <future>
#include <memory>
#include <utility>

#include "app/child.h"
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

/// Nothing was run: nothing is left.
void remove_run(const fs::path& dir) {
  std::error_code ignored;
  for (const char* name : {"run.sqlite", "run.sqlite-wal", "run.sqlite-shm", "images"})
    fs::remove(dir / name, ignored);
  fs::remove(dir, ignored);
}

Config make_config(const RecordOptions& options) {
  Config config;
  config.file = "record";
  config.name = fs::path(options.command.front()).filename().string();
  if (config.name.empty()) config.name = "command";
  config.sampler_rate_hz = options.rate_hz;
  config.json = {{"name", config.name},
                 {"question", "what does this program cost?"},
                 {"sampler", {{"rate_hz", config.sampler_rate_hz}, {"sources", "all"}}}};
  return config;
}

/// Sensors, sampler and recorder around one program.
class Recording {
 public:
  /// Finds the sensors and begins to record into `dir`, which this creates.
  ///
  /// The kernel counts the events of the thread that discovers, and of what that starts from then
  /// on. The threads of sampler and recorder are not to be among them: a thread that was there
  /// before starts them.
  explicit Recording(const RecordOptions& options)
      : options_(options),
        config_(make_config(options)),
        dir_(options.out.empty() ? default_run_dir(config_.name) : fs::path(options.out)) {
    std::future<void> started;
    std::promise<void> discovered;  // goes first, so that the thread never waits in vain
    started = std::async(std::launch::async, [this, gate = discovered.get_future()]() mutable {
      gate.get();
      start();
    });
    sensors_ = std::make_unique<Sensors>(
        options.root, config_,
        probe::Selection{.sources = {}, .allow_msr = options.allow_msr, .program = true});
    create_run_dir(dir_);
    std::error_code ignored;
    fs::remove(dir_ / "images", ignored);  // there are no frames to picture
    discovered.set_value();
    started.get();
  }

  [[nodiscard]] const fs::path& dir() const { return dir_; }

  ChildEnd run(const HeldSignals& signals) {
    const int64_t begin_ns = now_ns();
    set("command_begin_ns", std::to_string(begin_ns));
    const ChildEnd end = Child(options_.command, signals).wait();
    const int64_t end_ns = now_ns();
    sensors_->stop();
    for (Event& event : sensors_->drain_events()) writer_->add_event(std::move(event));
    for (const auto& [key, value] : sensors_->cost_meta()) set(key, value);
    std::string how = fmt::format("ended with exit code {}", end.exit_code);
    if (end.signal) {
      how = fmt::format("was ended by signal {} ({})", *end.signal, strsignal(*end.signal));
      set("command_signal", std::to_string(*end.signal));
    }
    writer_->add_event({begin_ns, end_ns, Severity::info, "command", std::nullopt,
                        fmt::format("'{}' {}", command(), how)});
    set("command_end_ns", std::to_string(end_ns));
    set("command_exit_code", std::to_string(end.exit_code));
    set("end_ns", std::to_string(now_ns()));
    writer_->close();
    return end;
  }

  /// Nothing was run: leaves nothing.
  void discard() {
    sensors_->stop();
    writer_.reset();
    remove_run(dir_);
  }

 private:
  [[nodiscard]] std::string command() const {
    return fmt::format("{}", fmt::join(options_.command, " "));
  }
  void set(std::string key, std::string value) {
    writer_->set_meta(std::move(key), std::move(value));
  }

  void start() {
    RunWriter::Config writer_config;
    writer_config.pull_samples = [this](std::vector<Sample>& out) { sensors_->drain(out); };
    writer_ = std::make_unique<RunWriter>(dir_ / "run.sqlite", std::move(writer_config));
    for (const Channel& channel : sensors_->channels()) writer_->add_channel(channel);
    set("name", config_.name);
    set("command", command());
    set("config", config_.json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
    set("host", describe_host().dump());
    set("code_version", ENERGYPROF_VERSION);
    set("build_type", ENERGYPROF_BUILD_TYPE);
    set("begin_ns", std::to_string(now_ns()));
    set("begin_utc", utc_now());
    set("interrupted", "0");
    set("simulated", options_.root == "/" ? "0" : "1");
    set("missing_sensors", sensors_->missing_json());
    set("verdict", sensors_->verdict());
    sensors_->start();
  }

  const RecordOptions& options_;
  Config config_;
  fs::path dir_;
  std::unique_ptr<Sensors> sensors_;
  std::unique_ptr<RunWriter> writer_;
};

}  // namespace

int record_command(const RecordOptions& options) {
  const HeldSignals signals;
  Recording recording(options);
  if (const auto signal = signals.end_wanted()) {
    recording.discard();
    return 128 + *signal;
  }
  ChildEnd end;
  try {
    end = recording.run(signals);
  } catch (const CannotRun&) {
    recording.discard();
    throw;
  }
  write_all_reports(recording.dir(), recording.dir() / "run.sqlite",
                    options.quiet ? nullptr : stderr);
  return end.exit_code;
}

}  // namespace energyprof::app
