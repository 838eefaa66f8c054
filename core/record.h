/// What is recorded during a run: plain structs, the vocabulary of every part.
///
/// All `_ns` are CLOCK_MONOTONIC (core/clock.h). Absent means unknown, never 0.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/unit.h"

namespace energyprof {

/// One stream of sensor values.
struct Channel {
  int32_t id = 0;      ///< 1-based, unique in a run; given by whoever gathers the channels
  std::string name;    ///< stable, dotted, source first: "rapl.package-0.energy"
  std::string source;  ///< the source that reads it: "powercap"
  Quantity quantity = Quantity::interference;
  Unit unit = Unit::none;  ///< the sensor's own unit
  Kind kind = Kind::gauge;
  std::optional<int64_t> wrap_at;       ///< a counter returns to 0 after this value
  int64_t period_ns = 0;                ///< how often it is polled
  std::optional<int64_t> read_cost_ns;  ///< median cost of one read, measured at start-up
  std::string origin;                   ///< file, event or function the value comes from
  /// What the value should stay below (temperature, power) or can reach (clock), in `unit`.
  std::optional<int64_t> limit;
  // Measured at start-up, absent where it could not be:
  std::optional<int64_t> read_cost_p99_ns;
  std::optional<int64_t> update_period_ns;  ///< median time between two changes of the value
  std::optional<int64_t> quantum;           ///< the smallest change seen, in `unit`
  bool stands_still = false;  ///< a counter that did not move under load: unsupported, not 0
  bool wakes_device = false;  ///< a read wakes a sleeping GPU: not polled while the run idles
  std::string gpu;            ///< PCI address or device name of the GPU it belongs to, or empty
  std::string unit_text;      ///< by read_run(): the unit as stored, even where `unit` has no name
};

/// One reading, exactly as the sensor gave it, in Channel::unit.
struct Sample {
  int32_t channel_id = 0;
  int64_t t_ns = 0;
  int64_t value = 0;
  /// How long the read took, where that makes t_ns uncertain: it is right within half of this. 0
  /// up to wide_read_ns.
  uint32_t width_ns = 0;
};
inline constexpr int64_t wide_read_ns = 50'000;

enum class Phase : uint8_t { warmup, timed, counted };

/// One frame: all rays of one image, traced once.
struct FrameRecord {
  int64_t id = 0;  ///< unique in a run
  int64_t trial_id = 0;
  int64_t frame = 0;  ///< index in its trial, warm-up included
  Phase phase = Phase::timed;
  int64_t submit_ns = 0;                  ///< host time of the (first) submission
  int64_t begin_ns = 0;                   ///< GPU begin, mapped to host time
  int64_t end_ns = 0;                     ///< begin_ns + the GPU's own duration
  std::optional<int64_t> clock_error_ns;  ///< begin_ns is right within +- this
  std::optional<int64_t> ray_count;
  std::optional<int64_t> hit_count;
  std::string hit_checksum;                 ///< docs/method.md; empty = unknown
  std::optional<int64_t> node_visit_count;  ///< counted frames only
  std::optional<int64_t> box_test_count;    ///< counted frames only
  std::optional<int64_t> prim_test_count;   ///< counted frames only
  std::optional<int64_t> loop_step_count;   ///< counted frames only
  /// Of the counted frame: sum over lanes of loop steps, divided by the sum over lanes of the most
  /// steps that a lane of the same subgroup took, ray kind by ray kind. 1 is best.
  std::optional<double> simd_efficiency;
  std::optional<int64_t> dispatch_count;  ///< row tiles the frame was cut into
};

/// One algorithm on one model from one view: warm-up frames, timed frames, a counted frame.
struct Trial {
  int64_t id = 0;
  std::string model;
  int64_t view = 0;
  std::string algorithm;
  int64_t repetition = 0;
  int64_t position = 0;  ///< place in the run's order
  int64_t begin_ns = 0;
  std::optional<int64_t> end_ns;  ///< absent: the run ended inside this trial
  std::string skip_reason;        ///< empty: usable
  std::optional<int64_t> build_ns;
  std::optional<int64_t> blob_bytes;
  std::optional<int64_t> triangle_count;
  std::optional<int64_t> node_count;
  std::optional<int64_t> leaf_count;
  std::optional<int64_t> ref_count;  ///< triangles in leaves, repetitions included
  std::optional<int64_t> max_depth;
  std::optional<double> sah_cost;
  std::string build_config;          ///< the builder's parameters, a JSON object; empty = unknown
  std::optional<bool> build_cached;  ///< the structure was read from disk; build_ns is the build's
  std::optional<int64_t> width;
  std::optional<int64_t> height;
  // The next four are modelled, not measured: docs/method.md. First repetition of a cell only.
  /// Different cache lines that the rays of a pixel read, times their size; mean.
  std::optional<double> bytes_per_pixel;
  std::optional<double> l1_misses_per_ray;
  std::optional<double> llc_misses_per_ray;
  std::optional<int64_t> footprint_bytes;  ///< likewise of all sampled pixels together
  std::string cache_model;                 ///< what was modelled, a JSON object; empty = nothing
};

enum class Severity : uint8_t { info, warning, error };

/// Something that happened: a missed deadline, a sensor that went away, a device that was lost.
struct Event {
  int64_t t_ns = 0;
  std::optional<int64_t> end_ns;
  Severity severity = Severity::info;
  std::string kind;  ///< machine-readable: "sensor-gone", "missed-ticks", ...
  std::optional<int32_t> channel_id;
  std::string text;
};

/// A frame of the self-check, which traces the same work with the sampler on and off in turn. It
/// belongs to no trial.
struct SelfCheckFrame {
  int64_t block = 0;  ///< consecutive frames with the sampler in one state; counted from 0
  bool sampler_on = true;
  int64_t begin_ns = 0;  ///< as FrameRecord's
  int64_t end_ns = 0;
};

/// The samples of one channel in time order, as analysis reads them.
struct SampleSeries {
  std::vector<int64_t> t_ns;
  std::vector<double> value;  ///< in Channel::unit
};

/// A read that took longer than wide_read_ns: the sample of this channel at t_ns.
struct WideRead {
  int64_t t_ns = 0;
  int64_t width_ns = 0;
};

/// Moments from here on, to either side of 0, are no times of a clock: 146 years. The difference of
/// two others never overflows.
inline constexpr int64_t endless_ns = int64_t{1} << 62;
constexpr bool is_moment(int64_t t_ns) { return t_ns > -endless_ns && t_ns < endless_ns; }

/// A whole recorded run, as read back from run.sqlite.
struct RunRecord {
  std::map<std::string, std::string> meta;
  std::vector<Channel> channels;
  std::map<int32_t, SampleSeries> series;  ///< by channel id; only channels that have samples
  std::map<int32_t, std::vector<WideRead>> wide_reads;  ///< by channel id
  std::vector<Trial> trials;                            ///< by begin_ns
  std::vector<FrameRecord> frames;                      ///< by submit_ns
  std::vector<SelfCheckFrame> self_check;               ///< by begin_ns
  std::vector<Event> events;                            ///< by t_ns
  std::vector<std::string> left_out;  ///< what of the file cannot be used, a sentence each
};

std::string_view to_string(Phase phase);
std::string_view to_string(Severity severity);

}  // namespace energyprof
