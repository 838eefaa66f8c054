#include "analysis/energy_curve.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "analysis/format.h"
#include "analysis/series.h"

namespace energyprof::analysis {
namespace {

/// Power is not known across a longer gap between two readings.
constexpr int64_t max_power_gap_polls = 5;

int64_t median_gap(const std::vector<int64_t>& t_ns) {
  std::vector<int64_t> gaps;
  for (std::size_t i = 1; i < t_ns.size(); ++i) gaps.push_back(t_ns[i] - t_ns[i - 1]);
  if (gaps.empty()) return 1;
  const auto middle = gaps.begin() + static_cast<std::ptrdiff_t>(gaps.size() / 2);
  std::nth_element(gaps.begin(), middle, gaps.end());
  return std::max<int64_t>(*middle, 1);
}

}  // namespace

EnergyCurve::EnergyCurve(const Channel& channel, const SampleSeries& series,
                         std::span<const Sleep> sleeps) {
  const std::string_view si = unit_info(channel.unit).si;
  if (channel.quantity == Quantity::energy && channel.kind == Kind::cumulative && si == "J")
    read_counter(channel, series, sleeps);
  else if (channel.quantity == Quantity::power && channel.kind != Kind::cumulative && si == "W")
    read_power(channel, series);
  else
    problem_ = fmt::format("{} in '{}' is neither an energy counter nor a power",
                           to_string(channel.kind), stored_unit(channel));
  if (!problem_.empty()) return;
  if (t_ns_.size() < 3) {
    problem_ = series.t_ns.empty() ? "no samples"
               : t_ns_.empty()
                   ? "it never moved: unsupported, not 0"
                   : fmt::format("it moved only {}, which is too seldom to tell anything",
                                 counted(t_ns_.size(), "time"));
    return;
  }
  if (update_ns_ == 0) update_ns_ = median_gap(t_ns_);
}

void EnergyCurve::read_counter(const Channel& channel, const SampleSeries& series,
                               std::span<const Sleep> sleeps) {
  const SampleSeries readings = tidy(series);
  const double factor = unit_info(channel.unit).to_si;
  const Unwrapped total = unwrap(channel, readings, sleeps);
  const std::vector<std::size_t> unknown = total.unknown();
  std::size_t unknown_until = 0;
  for (std::size_t i = 1; i < readings.value.size(); ++i) {
    const bool broken = unknown_until < unknown.size() && unknown[unknown_until] == i;
    // A broken value takes two steps, and a sleep may lie in any of several: that is one break.
    if (broken && (unknown_until == 0 || unknown[unknown_until - 1] != i - 1)) ++break_count_;
    if (broken) ++unknown_until;
    if (readings.value[i] == readings.value[i - 1] && !broken) continue;
    // It moved at some time since the reading before: half way is right on average.
    t_ns_.push_back(std::midpoint(readings.t_ns[i - 1], readings.t_ns[i]));
    blur_ns_.push_back(readings.t_ns[i] - t_ns_.back());
    joules_.push_back(total.value[i] * factor);
    breaks_until_.push_back(unknown_until);
  }
}

void EnergyCurve::read_power(const Channel& channel, const SampleSeries& series) {
  const SampleSeries readings = tidy(series);
  const double factor = unit_info(channel.unit).to_si;
  std::vector<int64_t> moved_ns;
  for (std::size_t i = 1; i < readings.t_ns.size(); ++i)
    if (readings.value[i] != readings.value[i - 1]) moved_ns.push_back(readings.t_ns[i]);
  if (moved_ns.size() < 2) return;
  const int64_t poll_ns = median_gap(readings.t_ns);
  double total_j = 0;
  for (std::size_t i = 0; i < readings.t_ns.size(); ++i) {
    if (i > 0) {
      const int64_t gap_ns = readings.t_ns[i] - readings.t_ns[i - 1];
      if (gap_ns > max_power_gap_polls * poll_ns) ++break_count_;
      total_j += (readings.value[i] + readings.value[i - 1]) / 2 * factor *
                 static_cast<double>(gap_ns) * 1e-9;
    }
    // A reading that repeats the last one is no update, but while power is steady it says so.
    t_ns_.push_back(readings.t_ns[i]);
    blur_ns_.push_back(poll_ns / 2);
    joules_.push_back(total_j);
    breaks_until_.push_back(break_count_);
  }
  update_ns_ = std::max(poll_ns, median_gap(moved_ns));
}

std::optional<Drawn> EnergyCurve::between(int64_t begin_ns, int64_t end_ns) const {
  if (!problem_.empty() || begin_ns >= end_ns || begin_ns < t_ns_.front() || end_ns > t_ns_.back())
    return std::nullopt;
  // The update that ends the stretch a moment lies in.
  const auto next = [&](int64_t t_ns) {
    const auto found = std::upper_bound(t_ns_.begin(), t_ns_.end(), t_ns);
    return std::min(static_cast<std::size_t>(found - t_ns_.begin()), t_ns_.size() - 1);
  };
  const std::size_t first = next(begin_ns);
  const std::size_t last = next(end_ns);
  if (breaks_until_[last] > breaks_until_[first - 1]) return std::nullopt;
  const auto gap_ns = [&](std::size_t i) { return static_cast<double>(t_ns_[i] - t_ns_[i - 1]); };
  const auto at = [&](std::size_t i, int64_t t_ns) {
    const double share = static_cast<double>(t_ns - t_ns_[i - 1]) / gap_ns(i);
    return joules_[i - 1] + share * (joules_[i] - joules_[i - 1]);
  };
  Drawn drawn;
  drawn.joules = at(last, end_ns) - at(first, begin_ns);
  const auto length_ns = static_cast<double>(end_ns - begin_ns);
  const double power = drawn.joules / length_ns;
  if (first == last) {
    // Inside one update: certain only as far as it fills it.
    drawn.error_j = (gap_ns(first) - length_ns) * power;
    return drawn;
  }
  // What an edge may be off by is the energy of the update it falls into, at least that of a usual
  // one: a counter that rests while nothing is drawn has long updates of little energy.
  const double least_j = power * static_cast<double>(std::min(update_ns_, end_ns - begin_ns));
  const auto edge_j = [&](std::size_t i) { return std::max(joules_[i] - joules_[i - 1], least_j); };
  drawn.error_j = std::hypot(edge_j(first), edge_j(last)) / std::sqrt(12.0);
  return drawn;
}

}  // namespace energyprof::analysis
