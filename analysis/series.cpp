#include "analysis/series.h"

#include <algorithm>
#include <cassert>
#include <numeric>
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

Unwrapped unwrap(const std::vector<double>& value, std::optional<int64_t> wrap_at) {
  Unwrapped result;
  result.value.reserve(value.size());
  double increase = 0;
  for (std::size_t i = 0; i < value.size(); ++i) {
    const double step = i == 0 ? 0 : value[i] - value[i - 1];
    if (step >= 0) {
      increase += step;
    } else if (wrap_at && value[i - 1] <= static_cast<double>(*wrap_at)) {
      increase += step + static_cast<double>(*wrap_at) + 1;
    } else {
      ++result.reset_count;
    }
    result.value.push_back(increase);
  }
  return result;
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

std::optional<Curve> rate(const Channel& channel, const SampleSeries& series) {
  const Cadence pace = cadence(series);
  if (!pace.poll_ns) return std::nullopt;
  const int64_t update_ns = std::min(pace.update_ns.value_or(*pace.poll_ns), 100 * ns_per_ms);
  const int64_t window_ns = 20 * std::max({*pace.poll_ns, update_ns, int64_t{1}});
  const double factor = unit_info(channel.unit).to_si;
  const std::vector<double> total = unwrap(series.value, channel.wrap_at).value;

  Curve curve;
  curve.unit = per_second(channel);
  std::size_t first = 0;
  for (std::size_t i = 1; i < total.size(); ++i) {
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

}  // namespace energyprof::analysis
