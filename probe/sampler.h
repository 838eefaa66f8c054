/// Polls sources on threads of its own, at absolute deadlines, without ever allocating or
/// blocking.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/record.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Samples every channel of some sources until stopped.
///
/// All quick sources share a thread; slow ones (SourceTraits::slow) have one of their own for each
/// source name, GPU and chip, so that a read that takes long delays nothing else. Each source is
/// polled at every n-th tick, n its period in ticks; a tick that was slept through or spent in a
/// poll is missed and counted, never made up for. Samples and events wait in queues of fixed size:
/// what does not fit is counted and reported.
///
/// One thread may call start(), stop(), pause(), resume() and the destructor. drain() and
/// drain_events() are for one thread at a time; set_idle(), latest() and stats() for any.
class Sampler {
 public:
  struct Config {
    /// Ticks per second. RAPL counters move every 0.976 ms: a prime rate does not beat with them.
    double rate_hz = 997.0;
    /// Samples that wait for drain(); 24 bytes each.
    size_t sample_capacity = size_t{1} << 18;
    /// Events that wait for drain_events().
    size_t event_capacity = size_t{1} << 10;
    /// Ask for SCHED_FIFO, priority 10, for the quick sources; goes on without where that is not
    /// allowed.
    bool realtime = true;
    /// Polling periods by source name, in place of the sources' own.
    std::map<std::string, int64_t> periods_ns;
  };

  struct Latest {
    int64_t t_ns = 0;
    int64_t value = 0;
  };

  struct Stats {
    int64_t tick_count = 0;         ///< ticks served, of the quick sources
    int64_t missed_tick_count = 0;  ///< ticks at which a source was due and was not polled
    int64_t sample_count = 0;
    int64_t lost_sample_count = 0;  ///< the queue was full
    int64_t lost_event_count = 0;   ///< the queue was full
    int64_t cpu_ns = 0;             ///< CPU time of all threads, updated a few times a second
    int64_t thread_count = 0;
    /// How late the thread of the quick sources woke, absent before the first tick. The quantiles
    /// are upper bounds, at most one eighth too high.
    std::optional<int64_t> lateness_p50_ns;
    std::optional<int64_t> lateness_p99_ns;
    std::optional<int64_t> lateness_max_ns;
    std::string scheduling;  ///< in words; empty before start()
  };

  /// The sources must outlive the sampler. Throws std::runtime_error unless 0 < rate_hz <= 100,000.
  explicit Sampler(std::span<const std::unique_ptr<SensorSource>> sources)
      : Sampler(sources, Config{}) {}
  Sampler(std::span<const std::unique_ptr<SensorSource>> sources, const Config& config);
  /// Stops.
  ~Sampler();
  Sampler(const Sampler&) = delete;
  Sampler& operator=(const Sampler&) = delete;

  /// All channels, with the period at which they are polled here.
  [[nodiscard]] std::vector<Channel> channels() const;

  /// Starts the threads and returns when every source was polled once. No effect while they run.
  /// Throws std::system_error if there can be no thread.
  void start();
  /// Polls every source a last time and ends the threads. No effect while they do not run.
  void stop();
  /// Polls every source once more and returns; from then on nothing is polled and no thread wakes.
  /// No effect unless running.
  void pause();
  /// Polls every source and goes on. No effect unless paused.
  void resume();
  /// Whether the GPU is meant to idle: then sources whose reads wake it are not polled.
  void set_idle(bool idle);

  /// Appends the samples taken since the last call; per channel, t_ns increases.
  void drain(std::vector<Sample>& samples);
  /// Appends what happened since the last call: "sensor-gone" and "sensor-unavailable" once per
  /// channel; "missed-ticks" and "samples-lost" with their span, at most once a second each and per
  /// thread.
  void drain_events(std::vector<Event>& events);
  /// The newest sample of a channel; nullopt before the first one.
  [[nodiscard]] std::optional<Latest> latest(int32_t channel_id) const;
  [[nodiscard]] Stats stats() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace energyprof::probe
