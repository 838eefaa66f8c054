/// Discovery and sampler as the study needs them: what is recorded, what is shown live.
#pragma once

#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "app/config.h"
#include "core/record.h"
#include "probe/discover.h"
#include "probe/sampler.h"

namespace energyprof::app {

class Sensors {
 public:
  /// Discovers the config's sources below `root`. Throws std::runtime_error when a quantity that
  /// the config requires cannot be sensed, UsageError for a source that does not exist.
  Sensors(const std::string& root, const Config& config);

  [[nodiscard]] const std::vector<Channel>& channels() const { return channels_; }
  /// [{source, reason, fix}]
  [[nodiscard]] nlohmann::json missing_json() const;
  [[nodiscard]] std::string verdict() const;

  void start();
  void stop();
  /// Appends the samples since the last call. Called by the recorder's thread.
  void drain(std::vector<Sample>& out);
  [[nodiscard]] std::vector<Event> drain_events();

  /// The highest temperature now, in degrees Celsius; absent without a temperature sensor.
  [[nodiscard]] std::optional<double> hottest_c() const;
  /// Clock, power and temperature now, for people; empty if none is sensed.
  [[nodiscard]] std::string live_values() const;
  /// What sampling cost: meta keys and values.
  [[nodiscard]] std::vector<std::pair<std::string, std::string>> cost_meta() const;

 private:
  [[nodiscard]] std::optional<double> latest_si(const Channel& channel) const;

  probe::Discovery discovery_;
  std::vector<Channel> channels_;
  std::unique_ptr<probe::Sampler> sampler_;
};

}  // namespace energyprof::app
