/// What a sensor is to the sampler: channels, a period, poll(). The only interface of this folder.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/record.h"

namespace energyprof::probe {

enum class PollStatus : uint8_t {
  ok,     ///< a value
  retry,  ///< no value this time: busy, asleep, half-written
  gone,   ///< there will never be one again: the device or file went away
};

/// One channel's answer to one poll.
struct Reading {
  PollStatus status = PollStatus::retry;
  int64_t t_ns = 0;      ///< midpoint of two clock reads around the read
  int64_t value = 0;     ///< in Channel::unit; meaningful when status is ok
  int64_t width_ns = 0;  ///< time between the two clock reads
  int error = 0;         ///< errno, where there is one and status is not ok
};

/// A channel. Without origin it is for add_file_source() to fill in.
Channel make_channel(std::string name, Quantity quantity, Unit unit, Kind kind = Kind::gauge,
                     std::string origin = {});

/// How a source's reads behave, and what they belong to.
struct SourceTraits {
  /// A read may take longer than a tick or block (firmware, bus transfers, driver locks): the
  /// source is polled on a thread for slow ones, so that it never delays the others.
  bool slow = false;
  /// A read wakes a sleeping GPU: the source is not polled while the run idles.
  bool wakes_device = false;
  /// The GPU it belongs to: "0000:00:02.0" or, where it is no PCI device, the last part of its
  /// device's path ("17000000.gpu"). Empty: it belongs to none.
  std::string gpu{};
  /// That GPU's UUID as Vulkan writes it, lower-case hex grouped 8-4-4-4-12; empty if not known.
  std::string gpu_uuid{};
  /// What a slow read waits for, where name and GPU do not say it: a chip. Slow sources of one
  /// name that wait for different ones do not delay each other.
  std::string chip{};
};

/// Channels that are read together, at one period.
class SensorSource {
 public:
  /// `name` becomes Channel::source and `period_ns` Channel::period_ns of every channel.
  SensorSource(std::string name, int64_t period_ns, std::vector<Channel> channels,
               SourceTraits traits = {});
  virtual ~SensorSource() = default;
  SensorSource(const SensorSource&) = delete;
  SensorSource& operator=(const SensorSource&) = delete;

  [[nodiscard]] std::string_view name() const { return name_; }
  /// How often reading makes sense: faster gives repeated values or costs too much.
  [[nodiscard]] int64_t period_ns() const { return period_ns_; }
  [[nodiscard]] const SourceTraits& traits() const { return traits_; }
  // For characterize(), which finds them out:
  void set_period_ns(int64_t period_ns);
  void mark_slow() { traits_.slow = true; }
  [[nodiscard]] std::span<const Channel> channels() const { return channels_; }
  /// For discover() and characterize(), which fill in ids, unique names and costs.
  [[nodiscard]] std::span<Channel> channels() { return channels_; }

  /// Reads every channel once; `out` has one Reading per channel, in their order.
  /// Called on the sampler's thread: no allocation, no exception. A channel that is gone stays gone
  /// and costs no system call any more.
  virtual void poll(std::span<Reading> out) noexcept = 0;

 private:
  std::string name_;
  int64_t period_ns_;
  std::vector<Channel> channels_;
  SourceTraits traits_;
};

/// Something that cannot be sensed here.
struct Missing {
  std::string source;  ///< "powercap"
  std::string reason;  ///< why, in words
  std::string fix;     ///< the exact command that would change it; empty: there is none
};

/// What can be sensed here, and what cannot.
struct Discovery {
  std::vector<std::unique_ptr<SensorSource>> sources;
  std::vector<Missing> missing;

  /// Whether an earlier source gives a channel of this name: energy that can be read in several
  /// ways is recorded once, in the way found first.
  [[nodiscard]] bool has_channel(std::string_view name) const;
};

/// Which sources to look for, and how.
struct Selection {
  std::vector<std::string> sources;  ///< names as of source_names(); empty: all
  bool allow_msr = false;            ///< read /dev/cpu/*/msr
  bool program = false;  ///< another program is measured: what tells of this process is left out
  std::string nvml_library = "libnvidia-ml.so.1";  ///< a name for dlopen(), or a path
};

}  // namespace energyprof::probe
