/// Discovery and sampler as the study needs them: what is recorded, what is shown live.
#pragma once

#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "app/config.h"
#include "core/record.h"
#include "probe/discover.h"
#include "probe/gpu_match.h"
#include "probe/sampler.h"

namespace energyprof::app {

/// Notices that the machine slept: CLOCK_MONOTONIC, the time of everything recorded, stands still
/// meanwhile, and counters may start anew.
class SuspendWatch {
 public:
  /// Looks now.
  void look();
  /// The suspends noticed since the last call: events of kind "suspend".
  std::vector<Event> take();

 private:
  std::mutex mutex_;
  std::optional<int64_t> asleep_ns_;  // CLOCK_BOOTTIME - CLOCK_MONOTONIC, at the last look
  int64_t looked_ns_ = 0;
  std::vector<Event> events_;
};

/// [{source, reason, fix}], without a fix null.
nlohmann::json missing_json(const std::vector<probe::Missing>& missing);

class Sensors {
 public:
  /// Discovers the config's sources below `root`. Throws std::runtime_error when a quantity that
  /// the config requires cannot be sensed, UsageError for a source that does not exist.
  Sensors(const std::string& root, const Config& config, const probe::Selection& selection);

  [[nodiscard]] const std::vector<Channel>& channels() const { return channels_; }
  /// missing_json() as text; bytes that are no UTF-8 are replaced.
  [[nodiscard]] std::string missing_json() const;
  [[nodiscard]] std::string verdict() const;

  /// Leaves out the sensors of GPUs that do not trace (probe::keep_gpu). Before start() and
  /// channels(). Throws like the constructor if that leaves a required quantity without a sensor.
  void keep_gpu(const probe::TracingDevice& device, const probe::Root& root, const Config& config);

  void start();
  void stop();
  /// Polls once more, then nothing until resume(), which begins with a poll.
  void pause();
  void resume();
  /// Whether the GPU is meant to idle: then nothing is read that would wake it.
  void set_idle(bool idle);
  /// Appends the samples since the last call. Called by the recorder's thread, often: between two
  /// calls is where a suspend of the machine is placed.
  void drain(std::vector<Sample>& out);
  [[nodiscard]] std::vector<Event> drain_events();

  /// The highest temperature now, in degrees Celsius; absent without a temperature sensor.
  [[nodiscard]] std::optional<double> hottest_c() const;
  /// Clock, power and temperature now, for people; empty if none is sensed.
  [[nodiscard]] std::string live_values() const;
  /// What sampling cost: meta keys and values.
  [[nodiscard]] std::vector<std::pair<std::string, std::string>> cost_meta() const;

 private:
  void make_sampler(const Config& config);
  [[nodiscard]] std::optional<double> latest_si(const Channel& channel) const;

  probe::Discovery discovery_;
  std::vector<Channel> channels_;
  std::unique_ptr<probe::Sampler> sampler_;
  SuspendWatch suspends_;
};

}  // namespace energyprof::app
