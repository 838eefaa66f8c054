#include "analysis/series.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <iterator>
#include <numeric>
#include <string_view>
#include <utility>

#include "core/clock.h"

namespace energyprof::analysis {
namespace {

std::optional<int64_t> middle(std::vector<int64_t> gaps) {
  if (gaps.empty()) return std::nullopt;
  const auto at = gaps.begin() + static_cast<std::ptrdiff_t>(gaps.size() / 2);
  std::nth_element(gaps.begin(), at, gaps.end());
  return *at;
}

void append(Curve& curve, int64_t t_ns, double value) {
  curve.t_ns.push_back(t_ns);
  curve.value.push_back(value);
}

std::string per_second(const Channel& channel) {
  if (channel.unit == Unit::none) return stored_unit(channel) + "/s";
  const std::string_view si = unit_info(channel.unit).si;
  return si == "J" ? "W" : std::string(si) + "/s";
}

}  // namespace

std::string stored_unit(const Channel& channel) {
  return channel.unit_text.empty() ? std::string(unit_info(channel.unit).name) : channel.unit_text;
}

std::vector<Sleep> sleeps_of(const RunRecord& run) {
  std::vector<Sleep> sleeps;
  for (const Event& event : run.events)
    if (event.kind == "suspend") sleeps.push_back({event.t_ns, event.end_ns.value_or(event.t_ns)});
  return sleeps;
}

Cadence cadence(const SampleSeries& series) {
  Cadence result;
  std::vector<int64_t> polls;
  std::vector<int64_t> updates;
  std::optional<int64_t> last_update_ns;
  for (std::size_t i = 1; i < series.t_ns.size(); ++i) {
    polls.push_back(series.t_ns[i] - series.t_ns[i - 1]);
    if (series.value[i] == series.value[i - 1]) continue;
    if (last_update_ns) updates.push_back(series.t_ns[i] - *last_update_ns);
    last_update_ns = series.t_ns[i];
    ++result.update_count;
  }
  result.poll_ns = middle(std::move(polls));
  result.update_ns = middle(std::move(updates));
  return result;
}

std::optional<double> fastest_rate(Unit unit) {
  const std::string_view si = unit_info(unit).si;
  if (si == "J") return 2e3;
  if (si == "s") return 1024;
  if (si == "B") return 2e13;
  if (unit == Unit::count) return 1e13;
  return std::nullopt;
}

namespace {

/// What a counter did from one sample to the next, and whether it can be believed.
class Steps {
 public:
  Steps(const Channel& channel, const SampleSeries& series, std::span<const Sleep> sleeps)
      : series_(series), sleeps_(sleeps) {
    if (channel.wrap_at) span_ = static_cast<double>(*channel.wrap_at) + 1;
    if (const auto rate = fastest_rate(channel.unit))
      fastest_per_ns_ = *rate / unit_info(channel.unit).to_si * 1e-9;
    const Cadence pace = cadence(series);
    update_ns_ = pace.update_ns.value_or(0);
    find_longest_gap(pace.poll_ns.value_or(0));
  }

  /// The increase up to sample `i`, wraps undone; nullopt where the counter started anew.
  [[nodiscard]] std::optional<double> increase(std::size_t i, int64_t changed_ns) const {
    double step = series_.value[i] - series_.value[i - 1];
    if (step < 0) {
      if (!span_ || series_.value[i - 1] >= *span_) return std::nullopt;
      step += *span_;
    }
    const auto time_ns = static_cast<double>(series_.t_ns[i] - changed_ns + update_ns_);
    if (fastest_per_ns_ && step > *fastest_per_ns_ * time_ns) return std::nullopt;
    return step;
  }
  [[nodiscard]] bool is_gap(std::size_t i) const {
    return longest_gap_ns_ && static_cast<double>(gap_ns(i)) > *longest_gap_ns_;
  }
  [[nodiscard]] bool may_have_slept(std::size_t i) const {
    return std::any_of(sleeps_.begin(), sleeps_.end(), [&](const Sleep& sleep) {
      return sleep.begin_ns < series_.t_ns[i] && sleep.end_ns >= series_.t_ns[i - 1];
    });
  }

 private:
  [[nodiscard]] int64_t gap_ns(std::size_t i) const {
    return series_.t_ns[i] - series_.t_ns[i - 1];
  }

  /// Half a wrap at the mean rate of all steps that are not much longer than usual.
  void find_longest_gap(int64_t usual_ns) {
    if (!span_) return;
    double total = 0;
    double time_ns = 0;
    int64_t changed_ns = series_.t_ns.empty() ? 0 : series_.t_ns.front();
    for (std::size_t i = 1; i < series_.value.size(); ++i) {
      const auto step = increase(i, changed_ns);
      if (series_.value[i] != series_.value[i - 1]) changed_ns = series_.t_ns[i];
      if (!step || gap_ns(i) > 10 * usual_ns) continue;
      total += *step;
      time_ns += static_cast<double>(gap_ns(i));
    }
    if (total > 0) longest_gap_ns_ = 0.5 * *span_ / total * time_ns;
  }

  const SampleSeries& series_;
  std::span<const Sleep> sleeps_;
  std::optional<double> span_;  // values that the counter can have
  std::optional<double> fastest_per_ns_;
  int64_t update_ns_ = 0;
  std::optional<double> longest_gap_ns_;
};

}  // namespace

std::vector<std::size_t> Unwrapped::unknown() const {
  std::vector<std::size_t> all;
  for (const auto* some : {&resets, &gaps, &sleeps})
    all.insert(all.end(), some->begin(), some->end());
  std::sort(all.begin(), all.end());
  return all;
}

Unwrapped unwrap(const Channel& channel, const SampleSeries& series,
                 std::span<const Sleep> sleeps) {
  Unwrapped result;
  if (series.value.empty()) return result;
  const Steps steps(channel, series, sleeps);
  result.value.reserve(series.value.size());
  result.value.push_back(0);
  int64_t changed_ns = series.t_ns.front();
  for (std::size_t i = 1; i < series.value.size(); ++i) {
    const auto step = steps.increase(i, changed_ns);
    std::vector<std::size_t>* const unknown = steps.may_have_slept(i) ? &result.sleeps
                                              : !step                 ? &result.resets
                                              : steps.is_gap(i)       ? &result.gaps
                                                                      : nullptr;
    if (unknown != nullptr) unknown->push_back(i);
    result.value.push_back(result.value.back() + (unknown == nullptr ? *step : 0.0));
    if (series.value[i] != series.value[i - 1]) changed_ns = series.t_ns[i];
  }
  return result;
}

std::optional<Curve> rate(const Channel& channel, const SampleSeries& series,
                          std::span<const Sleep> sleeps) {
  const Cadence pace = cadence(series);
  if (!pace.poll_ns) return std::nullopt;
  const int64_t update_ns = std::min(pace.update_ns.value_or(*pace.poll_ns), 100 * ns_per_ms);
  const int64_t window_ns = 20 * std::max({*pace.poll_ns, update_ns, int64_t{1}});
  const double factor = unit_info(channel.unit).to_si;
  const Unwrapped unwrapped = unwrap(channel, series, sleeps);
  const std::vector<double>& total = unwrapped.value;
  const std::vector<std::size_t> breaks = unwrapped.unknown();

  Curve curve;
  curve.unit = per_second(channel);
  std::size_t first = 0;
  auto next_break = breaks.begin();
  for (std::size_t i = 1; i < total.size(); ++i) {
    if (next_break != breaks.end() && *next_break == i) {
      first = i;
      ++next_break;
      continue;
    }
    const int64_t span_ns = series.t_ns[i] - series.t_ns[first];
    if (span_ns < window_ns) continue;
    append(curve, series.t_ns[i],
           (total[i] - total[first]) * factor / (static_cast<double>(span_ns) * 1e-9));
    first = i;
  }
  if (curve.t_ns.empty()) return std::nullopt;
  return curve;
}

std::vector<std::size_t> thin_points(const std::vector<int64_t>& t_ns,
                                     const std::vector<double>& value, std::size_t max_count) {
  assert(max_count >= 2);
  std::vector<std::size_t> kept;
  if (t_ns.size() <= max_count) {
    kept.resize(t_ns.size());
    std::iota(kept.begin(), kept.end(), std::size_t{0});
    return kept;
  }
  const auto bucket_count = static_cast<int64_t>(max_count / 2);
  const int64_t width_ns = (t_ns.back() - t_ns.front()) / bucket_count + 1;
  const auto bucket_of = [&](std::size_t i) { return (t_ns[i] - t_ns.front()) / width_ns; };
  for (std::size_t i = 0; i < t_ns.size();) {
    const int64_t bucket = bucket_of(i);
    std::size_t low = i;
    std::size_t high = i;
    for (; i < t_ns.size() && bucket_of(i) == bucket; ++i) {
      if (value[i] < value[low]) low = i;
      if (value[i] > value[high]) high = i;
    }
    kept.push_back(std::min(low, high));
    if (low != high) kept.push_back(std::max(low, high));
  }
  return kept;
}

std::vector<std::size_t> thin_beside(const std::vector<int64_t>& t_ns,
                                     const std::vector<double>& value,
                                     const std::vector<std::size_t>& kept, std::size_t max_count) {
  std::vector<std::size_t> others;
  std::vector<int64_t> others_t_ns;
  std::vector<double> others_value;
  auto next_kept = kept.begin();
  for (std::size_t i = 0; i < t_ns.size(); ++i) {
    if (next_kept != kept.end() && *next_kept == i) {
      ++next_kept;
      continue;
    }
    others.push_back(i);
    others_t_ns.push_back(t_ns[i]);
    others_value.push_back(value[i]);
  }
  std::vector<std::size_t> thinned = thin_points(others_t_ns, others_value, max_count);
  for (std::size_t& place : thinned) place = others[place];
  std::vector<std::size_t> result;
  std::merge(thinned.begin(), thinned.end(), kept.begin(), kept.end(), std::back_inserter(result));
  return result;
}

Curve thin(const Curve& curve, std::size_t max_count) {
  Curve result;
  result.unit = curve.unit;
  for (std::size_t i : thin_points(curve.t_ns, curve.value, max_count))
    append(result, curve.t_ns[i], curve.value[i]);
  return result;
}

Curve changes_only(const Curve& curve) {
  Curve result;
  result.unit = curve.unit;
  for (std::size_t i = 0; i < curve.t_ns.size(); ++i) {
    const bool last = i + 1 == curve.t_ns.size();
    if (i == 0 || last || curve.value[i] != curve.value[i - 1])
      append(result, curve.t_ns[i], curve.value[i]);
  }
  return result;
}

SampleSeries tidy(const SampleSeries& series) {
  const std::size_t count = std::min(series.t_ns.size(), series.value.size());
  std::vector<std::size_t> order;
  order.reserve(count);
  for (std::size_t i = 0; i < count; ++i)
    if (std::isfinite(series.value[i])) order.push_back(i);
  const auto earlier = [&](std::size_t a, std::size_t b) {
    return series.t_ns[a] < series.t_ns[b];
  };
  if (!std::is_sorted(order.begin(), order.end(), earlier))
    std::stable_sort(order.begin(), order.end(), earlier);
  SampleSeries result;
  result.t_ns.reserve(order.size());
  result.value.reserve(order.size());
  for (const std::size_t i : order) {
    if (!result.t_ns.empty() && result.t_ns.back() == series.t_ns[i]) {
      result.value.back() = series.value[i];
      continue;
    }
    result.t_ns.push_back(series.t_ns[i]);
    result.value.push_back(series.value[i]);
  }
  return result;
}

}  // namespace energyprof::analysis
