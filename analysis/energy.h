/// Joules per frame and per ray, and when to say nothing.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "analysis/frame_table.h"
#include "analysis/stats.h"
#include "core/record.h"

namespace energyprof::analysis {

/// A number that was estimated.
struct Estimate {
  double value = 0;
  Interval interval;          ///< 95 %
  double standard_error = 0;  ///< which the interval is made of, with Student's t
  double freedom = 0;         ///< degrees of freedom of that
};

/// What an energy or power channel belongs to. Some contain others: psys the package, the package
/// its cores and its integrated GPU. They are shown side by side and never added.
enum class EnergyDomain : uint8_t { gpu, integrated_gpu, package, core, dram, platform, other };
std::string_view to_string(EnergyDomain domain);
/// By the channel's name and source.
EnergyDomain energy_domain(const Channel& channel);

/// Joules of an algorithm on a model on one channel, or why there are none.
struct EnergyRow {
  std::string algorithm;
  std::string model;
  int64_t frame_count = 0;
  std::string refused;  ///< why a number is missing; empty: none is
  std::string channel;  ///< empty: there is none
  EnergyDomain domain = EnergyDomain::other;
  std::string method;  ///< "windows", "regression"; "..., power integrated"; empty where refused
  std::optional<Estimate> joules_per_frame;        ///< net: above idle
  std::optional<Estimate> gross_joules_per_frame;  ///< all that was drawn
  std::optional<Estimate> nj_per_ray;              ///< net
  std::optional<double> edp_js;                    ///< net joules x seconds, per frame
  std::optional<double> idle_w;                    ///< while these frames were traced
  std::optional<double> watts_above_idle;  ///< average while a frame was traced, gaps left out
  std::optional<double> edge_error_ratio;  ///< of gross: one standard deviation
  std::size_t window_count = 0;
};

struct EnergyConfig {
  double updates_per_window = 20;
  double max_error_ratio = 0.10;  ///< beyond: refused
  std::size_t replicate_count = 1'000;
  uint64_t seed = 1;
};

struct EnergyReport {
  std::vector<EnergyRow> rows;        ///< on the primary channel: by model, then algorithm
  std::vector<EnergyRow> by_channel;  ///< all channels, channel after channel
  std::vector<std::optional<double>>
      cell_joules_per_frame;  ///< net, on the primary channel; by cell
  std::vector<std::string> warnings;
};

/// What the device that traced is: decides whose energy counts.
enum class DeviceType : uint8_t { unknown, integrated, discrete, cpu };

/// Prices the timed frames of `cells` on every energy channel; where a domain has none, on its
/// power. docs/method.md says how. `frames` in time order.
EnergyReport price_energy(const RunRecord& run, std::span<const Cell> cells,
                          std::span<const TimedFrame> frames, DeviceType device,
                          const EnergyConfig& config = {});

}  // namespace energyprof::analysis
