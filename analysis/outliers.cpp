#include "analysis/outliers.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <boost/math/distributions/students_t.hpp>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <utility>

#include "analysis/stats.h"

namespace energyprof::analysis {
namespace {

constexpr std::size_t min_group_frames = 5;
constexpr double min_fast_share = 0.10;
// Frames this much faster than the rest are a regime of their own, also if they are fewer.
constexpr double clear_gap_ratio = 1.3;
constexpr double min_clear_share = 0.04;
constexpr double min_clear_count = 5;
constexpr double entirely_slow_ratio = 1.35;
constexpr int em_round_count = 12;
// One long stretch does not make spikes improbable: a slow frame is the last one at least so often.
constexpr double min_leave = 0.2;
// Noise is not believed to take a frame much further than this, whatever its tail.
constexpr double noise_reach_ratio = 1.35;
constexpr double min_noise_decay = 0.05;
// Spread that a trial is believed to have before it is seen, and for how many frames that counts.
constexpr double prior_spread = 0.03;
constexpr double prior_spread_frames = 4;
constexpr double min_spread = 0.003;
// From so many frames on a trial's own spread is good enough to learn the tail of the noise from.
constexpr std::size_t min_learning_frames = 20;
constexpr double least_seen_spread = 1e-4;

/// Frames that are judged together: a trial, or a cell whose trials are too short.
struct Group {
  std::vector<std::size_t> frames;  // into the span, by time
  std::vector<double> x;            // logarithm of their times
  std::vector<double> base;         // logarithm of the baseline at each
  double scale = prior_spread;      // robust standard deviation of the fast regime, as believed
  double seen_scale = 0;            // the same from its frames alone
  bool entirely_slow = false;
};

double robust_scale(std::vector<double> deviations) { return 1.4826 * median(deviations); }

// ---------------------------------------------------------------------------- drift

/// Growth per frame of log times. The median over differences at a lag of an eighth of the trial: a
/// step touches an eighth of them, a spike two, a drift all. 0 unless it stands out clearly.
double drift_per_frame(const std::vector<double>& x) {
  if (x.size() < 64) return 0;
  const std::size_t lag = x.size() / 8;
  std::vector<double> rises(x.size() - lag);
  for (std::size_t i = 0; i < rises.size(); ++i) rises[i] = x[i + lag] - x[i];
  const double rise = median(rises);
  std::vector<double> deviations;
  for (const double r : rises) deviations.push_back(std::abs(r - rise));
  const double error =
      1.2533 * robust_scale(deviations) / std::sqrt(static_cast<double>(rises.size()));
  if (std::abs(rise) < 4 * error) return 0;
  return rise / static_cast<double>(lag);
}

// ---------------------------------------------------------------------------- fast regime

/// A mode of the density with what lies around it.
struct Mode {
  double peak = 0;
  double height = 0;
  double begin = 0;  // the valleys around it
  double end = 0;
  double count = 0;
};

/// Modes of a kernel density of `sorted`, from low to high. Bumps that are no deeper apart than a
/// third of their height, or closer than an eighth, are one. See "Using Kernel Density Estimates
/// to Investigate Multimodality", by B. Silverman, JRSS B 43(1), 1981.
std::vector<Mode> find_modes(const std::vector<double>& sorted, double bandwidth) {
  const double step = bandwidth / 4;
  const double origin = sorted.front() - 4 * bandwidth;
  // Modes far above the lowest frames do not matter for the fast regime.
  const double reach = std::min(sorted.back() - sorted.front(), 6.0);
  const auto bin_count = static_cast<std::size_t>((reach + 8 * bandwidth) / step) + 2;
  std::vector<double> bins(bin_count, 0.0);
  for (const double x : sorted)
    bins[std::min(static_cast<std::size_t>((x - origin) / step), bin_count - 1)] += 1;

  std::array<double, 33> kernel{};
  for (std::size_t k = 0; k < kernel.size(); ++k) {
    const double z = (static_cast<double>(k) - 16) / 4;
    kernel[k] = std::exp(-0.5 * z * z);
  }
  std::vector<double> density(bin_count, 0.0);
  for (std::size_t i = 0; i < bin_count; ++i) {
    if (bins[i] == 0) continue;
    for (std::size_t k = 0; k < kernel.size(); ++k)
      if (i + k >= 16 && i + k - 16 < bin_count) density[i + k - 16] += bins[i] * kernel[k];
  }

  const auto at = [&](std::size_t bin) { return origin + (static_cast<double>(bin) + 0.5) * step; };
  std::vector<Mode> modes;
  std::size_t begin = 0;
  for (std::size_t i = 1; i < bin_count; ++i) {
    const bool valley = i + 1 == bin_count ||
                        (density[i] <= density[i - 1] && density[i] < density[i + 1]) ||
                        (density[i] == 0 && density[i - 1] > 0);
    if (!valley) continue;
    const auto peak = static_cast<std::size_t>(
        std::max_element(density.begin() + static_cast<std::ptrdiff_t>(begin),
                         density.begin() + static_cast<std::ptrdiff_t>(i)) -
        density.begin());
    if (density[peak] == 0) continue;
    Mode mode{at(peak), density[peak], at(begin), at(i),
              std::accumulate(bins.begin() + static_cast<std::ptrdiff_t>(begin),
                              bins.begin() + static_cast<std::ptrdiff_t>(i), 0.0)};
    const double floor = density[begin];
    begin = i;
    if (!modes.empty()) {
      Mode& before = modes.back();
      const bool shallow = floor > 0.67 * std::min(before.height, mode.height);
      if (shallow || mode.peak - before.peak < 0.118) {
        if (mode.height > before.height) {
          before.peak = mode.peak;
          before.height = mode.height;
        }
        before.end = mode.end;
        before.count += mode.count;
        continue;
      }
    }
    modes.push_back(mode);
  }
  return modes;
}

struct Spread {
  double believed = prior_spread;
  double seen = 0;
};

/// Robust standard deviation of the wider side of `deviations`: as seen, and as believed with a few
/// frames' worth of prior_spread mixed in. Ten frames that happen to be alike do not prove that
/// there is no noise.
Spread spread_of(const std::vector<double>& deviations) {
  Spread result{min_spread, least_seen_spread};
  std::vector<double> below;
  std::vector<double> above;
  for (const double d : deviations) (d < 0 ? below : above).push_back(std::abs(d));
  for (const std::vector<double>& side : {below, above}) {
    const double seen = side.empty() ? 0 : robust_scale(side);
    const auto count = static_cast<double>(side.size());
    const double believed =
        std::sqrt((count * seen * seen + prior_spread_frames * prior_spread * prior_spread) /
                  (count + prior_spread_frames));
    result.believed = std::max(result.believed, believed);
    result.seen = std::max(result.seen, seen);
  }
  return result;
}

struct Level {
  double centre = 0;
  Spread spread;
};

/// Centre and spread of the fast regime: the lowest mode with a tenth of the frames, or with fewer
/// where the next one is clearly apart.
Level fast_level(const std::vector<double>& x) {
  std::vector<double> sorted = x;
  std::sort(sorted.begin(), sorted.end());
  std::vector<double> steps;
  for (std::size_t i = 1; i < x.size(); ++i) steps.push_back(std::abs(x[i] - x[i - 1]));
  const double rough = steps.empty() ? 0 : robust_scale(steps) / std::sqrt(2.0);
  const double bandwidth = std::clamp(0.7 * rough, 0.02, 0.08);
  const std::vector<Mode> modes = find_modes(sorted, bandwidth);
  const double needed = std::max(std::min(3.0, static_cast<double>(x.size()) / 2),
                                 min_fast_share * static_cast<double>(x.size()));
  const double needed_if_clear =
      std::max(min_clear_count, min_clear_share * static_cast<double>(x.size()));
  auto found = modes.begin();
  for (; found != modes.end(); ++found) {
    if (found->count >= needed) break;
    // A frame during which the clock fell lies between the two regimes and is neither.
    const auto next = std::find_if(found + 1, modes.end(),
                                   [&](const Mode& mode) { return mode.count >= found->count; });
    const bool is_clear =
        next != modes.end() && next->peak - found->peak >= std::log(clear_gap_ratio);
    if (is_clear && found->count >= needed_if_clear) break;
  }
  const Mode mode = found != modes.end()
                        ? *found
                        : Mode{quantile(sorted, 0.25), 0, sorted.front(), sorted.back(), 0};

  std::vector<double> near;
  for (const double value : sorted)
    if (std::abs(value - mode.peak) <= 2 * bandwidth) near.push_back(value);
  Level level;
  level.centre = near.empty() ? mode.peak : median(near);
  std::vector<double> deviations;
  for (const double value : sorted)
    if (value >= mode.begin && value <= mode.end) deviations.push_back(value - level.centre);
  level.spread = spread_of(deviations);
  return level;
}

// ---------------------------------------------------------------------------- noise

/// Noise of the fast regime, in units of its robust standard deviation: a mixture of Student t
/// with the given weights, which are what the frames of all trials say about the tail.
class Noise {
 public:
  Noise() {
    for (std::size_t k = 0; k < freedom.size(); ++k) {
      const boost::math::students_t t(freedom[k]);
      // The robust standard deviation is 1.4826 times the upper quartile.
      unit_[k] = 1 / (1.4826 * boost::math::quantile(t, 0.75));
      peak_[k] = boost::math::pdf(t, 0.0);
    }
    weight_ = prior;
  }

  /// Learns from deviations above the centre, each known only because it is below `cut`: the
  /// slow frames beyond say nothing about noise.
  void learn(const std::vector<std::pair<double, double>>& deviation_and_cut) {
    std::array<double, freedom.size()> evidence{};
    // Logarithms of the truncated mass change slowly with the cut: few cuts, one per trial.
    std::map<double, std::array<double, freedom.size()>> mass;
    for (const auto& [z, cut] : deviation_and_cut) {
      auto found = mass.find(cut);
      if (found == mass.end()) {
        std::array<double, freedom.size()> logs{};
        for (std::size_t k = 0; k < freedom.size(); ++k)
          logs[k] =
              std::log(boost::math::cdf(boost::math::students_t(freedom[k]), cut / unit_[k]) - 0.5);
        found = mass.emplace(cut, logs).first;
      }
      for (std::size_t k = 0; k < freedom.size(); ++k)
        evidence[k] += std::log(density_of(k, z)) - found->second[k];
    }
    const double best = *std::max_element(evidence.begin(), evidence.end());
    double total = 0;
    for (std::size_t k = 0; k < freedom.size(); ++k) {
      weight_[k] = prior[k] * std::exp(evidence[k] - best);
      total += weight_[k];
    }
    for (double& weight : weight_) weight /= total;
  }

  [[nodiscard]] double density(double z) const {
    double sum = 0;
    for (std::size_t k = 0; k < freedom.size(); ++k)
      if (weight_[k] > 1e-6) sum += weight_[k] * density_of(k, z);
    return sum;
  }

 private:
  static constexpr std::array<double, 9> freedom{1.5, 2, 2.5, 3, 4, 5, 7, 12, 40};
  static constexpr std::array<double, 9> prior{0.03, 0.07, 0.12, 0.20, 0.22,
                                               0.16, 0.10, 0.06, 0.04};

  [[nodiscard]] double density_of(std::size_t k, double z) const {
    const double t = z / unit_[k];
    return peak_[k] / unit_[k] * std::pow(1 + t * t / freedom[k], -(freedom[k] + 1) / 2);
  }

  std::array<double, freedom.size()> unit_{};
  std::array<double, freedom.size()> peak_{};
  std::array<double, freedom.size()> weight_{};
};

// ---------------------------------------------------------------------------- two states

/// Density of the logarithm of the ratio in the slow state: an exponential from min_outlier_ratio
/// up, and what the slow frames of the group turned out to be.
class SlowDensity {
 public:
  [[nodiscard]] double operator()(double y) const {
    const double above = y - first_y;
    if (above < 0) return 0;
    const double broad = std::exp(-above);
    const std::size_t bin = bin_of(above);
    return (1 - learned_) * broad + learned_ * bins_[bin];
  }

  void learn(const std::vector<double>& y, const std::vector<double>& slow) {
    std::fill(bins_.begin(), bins_.end(), 0.0);
    double total = 0;
    for (std::size_t i = 0; i < y.size(); ++i) {
      if (y[i] < first_y) continue;
      // A triangle over three bins.
      const std::size_t bin = bin_of(y[i] - first_y);
      bins_[bin] += 0.5 * slow[i];
      bins_[bin > 0 ? bin - 1 : 0] += 0.25 * slow[i];
      bins_[std::min(bin + 1, bins_.size() - 1)] += 0.25 * slow[i];
      total += slow[i];
    }
    for (double& bin : bins_) bin /= std::max(total, 1e-9) * bin_width;
    // A handful of slow frames says little about where others lie.
    learned_ = 0.8 * total / (total + 10);
  }

 private:
  static constexpr double bin_width = 0.06;
  static inline const double first_y = std::log(min_outlier_ratio);
  static std::size_t bin_of(double above) {
    return std::min(static_cast<std::size_t>(above / bin_width), std::size_t{119});
  }
  std::vector<double> bins_ = std::vector<double>(120, 0.0);
  double learned_ = 0;
};

/// Probability of the slow state for each frame: forward and backward passes, transition rates by
/// expectation maximization with weak priors. See "A Maximization Technique Occurring in the
/// Statistical Analysis of Probabilistic Functions of Markov Chains", by L. Baum, T. Petrie, G.
/// Soules and N. Weiss, Annals of Mathematical Statistics 41(1), 1970.
std::vector<double> slow_probability(const Group& group, const Noise& noise) {
  const std::size_t count = group.x.size();
  std::vector<double> y(count);
  std::vector<double> fast_density(count);
  for (std::size_t i = 0; i < count; ++i) {
    y[i] = group.x[i] - group.base[i];
    // Faster than the baseline is as good as at it: only the upper tail competes with slowness.
    fast_density[i] = noise.density(std::max(y[i], 0.0) / group.scale) / group.scale;
    const double beyond = y[i] - std::log(noise_reach_ratio);
    if (beyond > 0) fast_density[i] *= std::exp(-beyond / std::max(group.scale, min_noise_decay));
  }
  SlowDensity slow_density;
  double enter = 0.01;
  double leave = 0.4;
  std::vector<double> slow(count, 0.0);
  std::vector<double> forward(count);
  std::vector<double> norm(count);
  std::vector<double> emit_slow(count);
  for (int round = 0; round < em_round_count; ++round) {
    for (std::size_t i = 0; i < count; ++i) emit_slow[i] = slow_density(y[i]);
    double prior_slow = enter / (enter + leave);
    for (std::size_t i = 0; i < count; ++i) {
      const double s = prior_slow * emit_slow[i];
      const double f = (1 - prior_slow) * fast_density[i];
      norm[i] = std::max(s + f, 1e-300);
      forward[i] = s / norm[i];
      prior_slow = forward[i] * (1 - leave) + (1 - forward[i]) * enter;
    }
    double back_slow = 1;
    double back_fast = 1;
    double entered = 0;
    double left = 0;
    double was_slow = 0;
    double was_fast = 0;
    for (std::size_t i = count; i-- > 0;) {
      const double s = forward[i] * back_slow;
      const double f = (1 - forward[i]) * back_fast;
      slow[i] = s / std::max(s + f, 1e-300);
      if (i == 0) break;
      const double to_slow = emit_slow[i] * back_slow / norm[i];
      const double to_fast = fast_density[i] * back_fast / norm[i];
      const double before = forward[i - 1];
      const double sf = before * leave * to_fast;
      const double ss = before * (1 - leave) * to_slow;
      const double fs = (1 - before) * enter * to_slow;
      const double ff = (1 - before) * (1 - enter) * to_fast;
      const double sum = std::max(sf + ss + fs + ff, 1e-300);
      entered += fs / sum;
      left += sf / sum;
      was_slow += (sf + ss) / sum;
      was_fast += (fs + ff) / sum;
      back_slow = leave * to_fast + (1 - leave) * to_slow;
      back_fast = enter * to_slow + (1 - enter) * to_fast;
      const double scale = std::max(back_slow, back_fast);
      if (scale > 0) {
        back_slow /= scale;
        back_fast /= scale;
      }
    }
    // As if 1 entry in 100 fast frames and 2 exits in 5 slow ones had been seen before.
    enter = (entered + 1) / (was_fast + 100);
    leave = std::max((left + 2) / (was_slow + 5), min_leave);
    slow_density.learn(y, slow);
  }
  return slow;
}

/// Lets the baseline follow what drift there is beyond a straight line: at each of a few places the
/// median deviation of the fast frames around it.
void follow_drift(Group& group, const std::vector<double>& slow) {
  std::vector<std::size_t> fast;
  for (std::size_t i = 0; i < slow.size(); ++i)
    if (slow[i] < 0.5) fast.push_back(i);
  if (fast.size() < 64) return;
  const std::size_t window = std::max<std::size_t>(32, fast.size() / 16);
  std::vector<std::pair<double, double>> knots;  // place, correction
  for (std::size_t first = 0; first + window <= fast.size(); first += window / 2) {
    std::vector<double> deviations;
    for (std::size_t k = first; k < first + window; ++k)
      deviations.push_back(group.x[fast[k]] - group.base[fast[k]]);
    knots.emplace_back(static_cast<double>(fast[first + window / 2]), median(deviations));
  }
  std::size_t next = 0;
  for (std::size_t i = 0; i < group.base.size(); ++i) {
    const auto place = static_cast<double>(i);
    while (next < knots.size() && knots[next].first <= place) ++next;
    double correction = 0;
    if (next == 0) {
      correction = knots.front().second;
    } else if (next == knots.size()) {
      correction = knots.back().second;
    } else {
      const auto& [x0, y0] = knots[next - 1];
      const auto& [x1, y1] = knots[next];
      correction = y0 + (y1 - y0) * (place - x0) / (x1 - x0);
    }
    group.base[i] += correction;
  }
  std::vector<double> deviations;
  for (const std::size_t i : fast) deviations.push_back(group.x[i] - group.base[i]);
  const Spread spread = spread_of(deviations);
  group.scale = spread.believed;
  group.seen_scale = spread.seen;
}

// ---------------------------------------------------------------------------- putting together

std::vector<Group> make_groups(std::span<const TimedFrame> frames) {
  std::map<std::pair<std::size_t, std::size_t>, Group> by_trial;  // cell, trial
  for (std::size_t i = 0; i < frames.size(); ++i)
    by_trial[{frames[i].cell, frames[i].trial_index}].frames.push_back(i);
  std::vector<Group> groups;
  std::map<std::size_t, Group> short_trials;  // by cell
  for (auto& [key, group] : by_trial) {
    if (group.frames.size() >= min_group_frames) {
      groups.push_back(std::move(group));
      continue;
    }
    auto& pooled = short_trials[key.first].frames;
    pooled.insert(pooled.end(), group.frames.begin(), group.frames.end());
  }
  for (auto& [cell, group] : short_trials) groups.push_back(std::move(group));
  for (Group& group : groups) {
    std::sort(group.frames.begin(), group.frames.end());
    for (const std::size_t i : group.frames) group.x.push_back(std::log(frames[i].ms));
  }
  std::sort(groups.begin(), groups.end(),
            [](const Group& a, const Group& b) { return a.frames.front() < b.frames.front(); });
  return groups;
}

void set_baseline(Group& group) {
  const double drift = drift_per_frame(group.x);
  const double middle = static_cast<double>(group.x.size() - 1) / 2;
  std::vector<double> level = group.x;
  for (std::size_t i = 0; i < level.size(); ++i)
    level[i] -= drift * (static_cast<double>(i) - middle);
  const Level fast = fast_level(level);
  group.scale = fast.spread.believed;
  group.seen_scale = fast.spread.seen;
  for (std::size_t i = 0; i < level.size(); ++i)
    group.base.push_back(fast.centre + drift * (static_cast<double>(i) - middle));
}

/// Trials slow from end to end are measured from the fastest trial of their cell.
void compare_trials(std::vector<Group>& groups, std::span<const TimedFrame> frames) {
  std::map<std::size_t, const Group*> fastest;  // by cell
  const auto centre = [](const Group& group) { return group.base[group.base.size() / 2]; };
  for (const Group& group : groups) {
    const Group*& best = fastest[frames[group.frames.front()].cell];
    if (best == nullptr || centre(group) < centre(*best)) best = &group;
  }
  for (Group& group : groups) {
    const Group& best = *fastest[frames[group.frames.front()].cell];
    if (centre(group) - centre(best) < std::log(entirely_slow_ratio)) continue;
    group.entirely_slow = true;
    group.scale = best.scale;
    group.seen_scale = best.seen_scale;
  }
  for (Group& group : groups)
    if (group.entirely_slow) {
      const Group& best = *fastest[frames[group.frames.front()].cell];
      group.base.assign(group.base.size(), centre(best));
    }
}

/// What a cell's fastest trial took, as the logarithm of a ratio to what it takes unthrottled:
/// where the frames of its fast regime were held back, by what the clock lacked.
double held_back_in(const Group& group, std::span<const double> clock_ratio) {
  constexpr double near = 0.1;
  std::vector<double> held;
  for (std::size_t i = 0; i < group.x.size(); ++i)
    if (std::abs(group.x[i] - group.base[i]) < near)
      held.push_back(-std::log(clock_ratio[group.frames[i]]));
  return held.empty() ? 0 : median(held);
}

/// Marks the cells all of whose trials were throttled from the first frame to the last: only the
/// clock tells how long their frames take else, as work is clock x time.
void compare_clocks(std::vector<Group>& groups, std::span<const TimedFrame> frames,
                    std::span<const double> clock_ratio) {
  std::map<std::size_t, double> least;  // by cell
  for (const Group& group : groups) {
    const double held = held_back_in(group, clock_ratio);
    const auto [found, is_new] =
        least.emplace(frames[group.frames.front()].cell, group.entirely_slow ? INFINITY : held);
    if (!is_new && !group.entirely_slow) found->second = std::min(found->second, held);
  }
  for (Group& group : groups) {
    const double held = least.at(frames[group.frames.front()].cell);
    if (!(held >= std::log(entirely_slow_ratio)) || std::isinf(held)) continue;
    group.entirely_slow = true;
    for (double& base : group.base) base -= held;
  }
}

}  // namespace

std::string_view to_string(OutlierShape shape) {
  return shape == OutlierShape::spike ? "spike" : "stretch";
}

OutlierSearch find_slow_frames(std::span<const TimedFrame> frames,
                               std::span<const double> clock_ratio) {
  OutlierSearch result;
  result.baseline_ms.resize(frames.size());
  std::vector<Group> groups = make_groups(frames);
  tbb::parallel_for(std::size_t{0}, groups.size(), [&](std::size_t g) { set_baseline(groups[g]); });
  compare_trials(groups, frames);
  if (!clock_ratio.empty()) compare_clocks(groups, frames, clock_ratio);

  Noise noise;
  const bool any_long = std::any_of(groups.begin(), groups.end(), [](const Group& group) {
    return group.x.size() >= min_learning_frames;
  });
  const auto learn = [&](const std::vector<std::vector<double>>& slow) {
    std::vector<std::pair<double, double>> deviations;
    for (std::size_t g = 0; g < groups.size(); ++g) {
      const Group& group = groups[g];
      if (any_long && group.x.size() < min_learning_frames) continue;
      // Measured by what a quiet trial is believed to spread, all its frames would be near the
      // centre, as those of a noise with the heaviest tail are.
      const double unit = any_long ? group.seen_scale : group.scale;
      const double cut = std::log(1.2) / unit;
      for (std::size_t i = 0; i < group.x.size(); ++i) {
        const double z = (group.x[i] - group.base[i]) / unit;
        if (z > 0 && z < cut && (slow.empty() || slow[g][i] < 0.5)) deviations.emplace_back(z, cut);
      }
    }
    noise.learn(deviations);
  };
  std::vector<std::vector<double>> slow;
  learn(slow);
  slow.resize(groups.size());
  tbb::parallel_for(std::size_t{0}, groups.size(), [&](std::size_t g) {
    slow[g] = slow_probability(groups[g], noise);
    if (!groups[g].entirely_slow) follow_drift(groups[g], slow[g]);
  });
  learn(slow);
  tbb::parallel_for(std::size_t{0}, groups.size(),
                    [&](std::size_t g) { slow[g] = slow_probability(groups[g], noise); });

  struct Found {
    SlowFrame frame;
    std::size_t place;
  };
  for (std::size_t g = 0; g < groups.size(); ++g) {
    const Group& group = groups[g];
    TrialRegime regime;
    regime.trial_index = frames[group.frames.front()].trial_index;
    regime.cell = frames[group.frames.front()].cell;
    regime.frame_count = group.frames.size();
    regime.baseline_ms = std::exp(group.base[group.base.size() / 2]);
    regime.spread_ratio = group.scale;
    regime.drift_ratio = std::exp(group.base.back() - group.base.front());
    regime.entirely_slow = group.entirely_slow;
    std::size_t episode_begin = result.slow.size();
    const auto close_episode = [&] {
      const std::size_t length = result.slow.size() - episode_begin;
      if (length == 0) return;
      for (std::size_t k = episode_begin; k < result.slow.size(); ++k) {
        result.slow[k].episode = result.episode_count;
        result.slow[k].shape = length >= 3 ? OutlierShape::stretch : OutlierShape::spike;
      }
      ++result.episode_count;
      episode_begin = result.slow.size();
    };
    for (std::size_t i = 0; i < group.x.size(); ++i) {
      const std::size_t frame = group.frames[i];
      result.baseline_ms[frame] = std::exp(group.base[i]);
      const double ratio = std::exp(group.x[i] - group.base[i]);
      if (slow[g][i] < 0.5 || ratio < min_outlier_ratio) {
        close_episode();
        continue;
      }
      // Short trials pooled in a group do not follow each other.
      if (i > 0 && frames[group.frames[i - 1]].trial_index != frames[frame].trial_index)
        close_episode();
      result.slow.push_back(
          {frame, result.baseline_ms[frame], ratio, slow[g][i], OutlierShape::spike, 0});
      ++regime.outlier_count;
    }
    close_episode();
    result.trials.push_back(regime);
  }
  std::stable_sort(result.slow.begin(), result.slow.end(),
                   [](const SlowFrame& a, const SlowFrame& b) { return a.frame < b.frame; });
  return result;
}

}  // namespace energyprof::analysis
