#include "analysis/frame_table.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <unordered_map>
#include <utility>

#include "analysis/analyze.h"
#include "analysis/series.h"

namespace energyprof::analysis {
namespace {

constexpr std::size_t min_update_count = 8;

/// The `share` quantile of `values`, one of them; nullopt of none.
std::optional<int64_t> order_statistic(std::vector<int64_t> values, double share) {
  if (values.empty()) return std::nullopt;
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace

std::vector<TimedFrame> timed_frames(const RunRecord& run, std::span<const Cell> cells) {
  std::unordered_map<int64_t, std::size_t> trial_index;
  for (std::size_t i = 0; i < run.trials.size(); ++i) trial_index.emplace(run.trials[i].id, i);
  std::vector<TimedFrame> frames;
  for (std::size_t c = 0; c < cells.size(); ++c)
    for (const std::size_t i : cells[c].frame_index) {
      const FrameRecord& frame = run.frames[i];
      const auto trial = trial_index.find(frame.trial_id);
      if (trial == trial_index.end() || frame.end_ns <= frame.begin_ns) continue;
      frames.push_back({i, trial->second, c, frame.begin_ns, frame.end_ns,
                        static_cast<double>(frame.end_ns - frame.begin_ns) * 1e-6});
    }
  std::stable_sort(frames.begin(), frames.end(), [](const TimedFrame& a, const TimedFrame& b) {
    return a.begin_ns != b.begin_ns ? a.begin_ns < b.begin_ns : a.frame_index < b.frame_index;
  });
  return frames;
}

ChannelTrack::ChannelTrack(const Channel& channel, const SampleSeries& series,
                           std::span<const Sleep> sleeps)
    : kind_(channel.kind) {
  SampleSeries tidied = tidy(series);
  t_ns_ = tidied.t_ns;
  const double factor = unit_info(channel.unit).to_si;

  std::vector<int64_t> polls;
  polls.reserve(t_ns_.size());
  for (std::size_t i = 1; i < t_ns_.size(); ++i) polls.push_back(t_ns_[i] - t_ns_[i - 1]);
  poll_ns_ = order_statistic(std::move(polls), 0.75).value_or(channel.period_ns);
  poll_ns_ = std::max({poll_ns_, int64_t{1}});
  resolution_ns_ = poll_ns_;

  if (kind_ == Kind::cumulative) {
    value_ = unwrap(channel, tidied, sleeps).value;
    std::vector<int64_t> updates;
    std::optional<int64_t> last_ns;
    for (std::size_t i = 1; i < value_.size(); ++i) {
      if (value_[i] == value_[i - 1]) continue;
      if (last_ns) updates.push_back(t_ns_[i] - *last_ns);
      last_ns = t_ns_[i];
    }
    if (updates.size() >= min_update_count)
      resolution_ns_ = std::max(poll_ns_, *order_statistic(std::move(updates), 0.1));
    for (double& value : value_) value *= factor;
    return;
  }

  value_ = std::move(tidied.value);
  for (double& value : value_) value = kind_ == Kind::flag ? (value != 0 ? 1 : 0) : value * factor;
  covered_s_.reserve(t_ns_.size());
  integral_.reserve(t_ns_.size());
  double covered_s = 0;
  double integral = 0;
  for (std::size_t i = 0; i < t_ns_.size(); ++i) {
    covered_s_.push_back(covered_s);
    integral_.push_back(integral);
    if (i + 1 == t_ns_.size()) break;
    const double held_s = seconds(std::min(t_ns_[i + 1] - t_ns_[i], stale_after_polls * poll_ns_));
    covered_s += held_s;
    integral += held_s * (value_[i] - value_[0]);
  }
}

/// Polls are spaced nearly evenly: begins where even spacing has `t_ns`, and widens from there.
std::size_t ChannelTrack::first_from(int64_t t_ns) const {
  const std::size_t n = t_ns_.size();
  if (n == 0 || t_ns <= t_ns_.front()) return 0;
  if (t_ns > t_ns_.back()) return n;
  const double share =
      static_cast<double>(t_ns - t_ns_.front()) / static_cast<double>(t_ns_.back() - t_ns_.front());
  std::size_t low = static_cast<std::size_t>(share * static_cast<double>(n - 1));
  std::size_t high = low;
  for (std::size_t step = 1; low > 0 && t_ns_[low] >= t_ns; step *= 2) {
    high = low;
    low -= std::min(low, step);
  }
  for (std::size_t step = 1; t_ns_[high] < t_ns; step *= 2) {
    low = high;
    high = std::min(n - 1, high + step);
  }
  const auto begin = t_ns_.begin();
  const auto found = std::lower_bound(begin + static_cast<std::ptrdiff_t>(low),
                                      begin + static_cast<std::ptrdiff_t>(high), t_ns);
  return static_cast<std::size_t>(found - begin);
}

std::optional<double> ChannelTrack::mean_over(int64_t begin_ns, int64_t end_ns) const {
  // Covered time and integral from the first sample up to t_ns.
  const auto up_to = [&](int64_t t_ns) {
    const std::size_t next = first_from(t_ns + 1);
    if (next == 0) return std::pair(0.0, 0.0);
    const std::size_t i = next - 1;
    const double held_s = seconds(std::min(t_ns - t_ns_[i], stale_after_polls * poll_ns_));
    return std::pair(covered_s_[i] + held_s, integral_[i] + held_s * (value_[i] - value_[0]));
  };
  const auto [begin_s, begin_integral] = up_to(begin_ns);
  const auto [end_s, end_integral] = up_to(end_ns);
  const double covered_s = end_s - begin_s;
  if (covered_s <= 1e-12) return std::nullopt;
  // A difference of large sums: keep rounding from leaving the range that a flag can have.
  const double mean = value_[0] + (end_integral - begin_integral) / covered_s;
  return kind_ == Kind::flag ? std::clamp(mean, 0.0, 1.0) : mean;
}

std::optional<double> ChannelTrack::inside(int64_t begin_ns, int64_t end_ns) const {
  if (kind_ == Kind::cumulative) return std::nullopt;
  const std::size_t first = first_from(begin_ns);
  std::size_t last = first;
  double sum = 0;
  for (; last < t_ns_.size() && t_ns_[last] < end_ns; ++last) sum += value_[last];
  if (first == last) return std::nullopt;
  return sum / static_cast<double>(last - first);
}

double ChannelTrack::counter_at(int64_t t_ns) const {
  const std::size_t i = first_from(t_ns + 1);
  if (i == 0) return value_.front();
  if (i == t_ns_.size()) return value_.back();
  const double share =
      static_cast<double>(t_ns - t_ns_[i - 1]) / static_cast<double>(t_ns_[i] - t_ns_[i - 1]);
  return value_[i - 1] + share * (value_[i] - value_[i - 1]);
}

std::optional<double> ChannelTrack::increase(int64_t begin_ns, int64_t end_ns) const {
  if (kind_ != Kind::cumulative || t_ns_.size() < 2) return std::nullopt;
  const int64_t reach_ns = stale_after_polls * poll_ns_;
  if (begin_ns < t_ns_.front() - reach_ns || end_ns > t_ns_.back() + reach_ns) return std::nullopt;
  if (end_ns <= t_ns_.front() || begin_ns >= t_ns_.back()) return std::nullopt;
  return counter_at(end_ns) - counter_at(begin_ns);
}

std::optional<double> ChannelTrack::over(int64_t begin_ns, int64_t end_ns) const {
  if (t_ns_.empty() || end_ns <= begin_ns) return std::nullopt;
  if (kind_ != Kind::cumulative) return mean_over(begin_ns, end_ns);
  const int64_t missing_ns = std::max<int64_t>(resolution_ns_ - (end_ns - begin_ns), 0);
  begin_ns -= missing_ns / 2;
  end_ns += missing_ns - missing_ns / 2;
  const auto rise = increase(begin_ns, end_ns);
  if (!rise) return std::nullopt;
  // Only the part between the first and the last reading is known.
  const int64_t known_ns = std::min(end_ns, t_ns_.back()) - std::max(begin_ns, t_ns_.front());
  return *rise / seconds(known_ns);
}

std::size_t ChannelTrack::sample_count(int64_t begin_ns, int64_t end_ns) const {
  const std::size_t first = first_from(begin_ns);
  return std::max(first_from(end_ns), first) - first;
}

std::vector<std::optional<double>> align(const Channel& channel, const SampleSeries& series,
                                         std::span<const TimedFrame> frames) {
  const ChannelTrack track(channel, series);
  std::vector<std::optional<double>> result;
  result.reserve(frames.size());
  for (const TimedFrame& frame : frames) result.push_back(track.over(frame.begin_ns, frame.end_ns));
  return result;
}

}  // namespace energyprof::analysis
