#include "planted_ratios.h"

#include <fmt/format.h>

#include <cmath>
#include <iterator>
#include <random>

namespace energyprof::analysis::planted {
namespace {

constexpr double frame_spread = 0.01;

/// Frame times of one trial.
std::vector<double> make_trial(const RatioScenario& scenario, double log_level,
                               std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> chance;
  const double rho = scenario.autocorrelation;
  const double level = log_level + scenario.trial_spread * normal(random);
  double state = normal(random);
  std::vector<double> values;
  for (std::size_t i = 0; i < scenario.frame_count; ++i) {
    state = rho * state + std::sqrt(1 - rho * rho) * normal(random);
    double x = frame_spread * state;
    if (scenario.heavy_tails) {
      // Lognormal, whose median stays at 0, and one frame in twenty is up to 65 % slower.
      x = frame_spread * (std::exp(0.8 * state) - 1);
      if (chance(random) < 0.05) x += 0.5 * chance(random);
    }
    values.push_back(std::exp(level + x));
  }
  return values;
}

}  // namespace

RatioScenario scenario(uint64_t index) {
  std::mt19937_64 random(index);
  const auto one_of = [&](auto... values) {
    const std::common_type_t<decltype(values)...> all[] = {values...};
    return all[random() % std::size(all)];
  };
  RatioScenario result;
  result.repetition_count = one_of(1u, 2u, 3u, 5u);
  result.cell_count = one_of(1u, 2u, 3u, 6u, 12u);
  result.frame_count = one_of(12u, 40u, 64u, 150u);
  result.autocorrelation = one_of(0.0, 0.5, 0.9);
  result.heavy_tails = one_of(false, true);
  result.trial_spread = one_of(0.0, 0.003, 0.01, 0.03);
  result.ratio_spread = one_of(0.0, 0.1);
  return result;
}

PlantedPairs make_pairs(const RatioScenario& scenario, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  PlantedPairs planted;
  for (std::size_t cell = 0; cell < scenario.cell_count; ++cell) {
    const double log_ms = std::log(1 + static_cast<double>(cell));
    planted.log_ratios.push_back(scenario.ratio_spread * normal(random));
    TrialPair& pair = planted.pairs.emplace_back();
    for (std::size_t i = 0; i < scenario.repetition_count; ++i) {
      pair.a.push_back(make_trial(scenario, log_ms, random));
      pair.b.push_back(make_trial(scenario, log_ms + planted.log_ratios.back(), random));
    }
  }
  return planted;
}

void Coverage::add(const RatioScenario& scenario, uint64_t seed) {
  const PlantedPairs planted = make_pairs(scenario, seed);
  const Ratios ratios = ratios_of(planted.pairs);
  const auto holds = [](const Ratio& ratio, double log_truth) {
    const double truth = std::exp(log_truth);
    return ratio.interval.low <= truth && truth <= ratio.interval.high;
  };
  const auto log_width = [](const Ratio& ratio) {
    return std::log(std::log(ratio.interval.high / ratio.interval.low) / 2);
  };
  Count count;
  count.run = 1;
  count.all_cells = 1;
  const auto cell_count = static_cast<double>(planted.pairs.size());
  for (std::size_t i = 0; i < planted.pairs.size(); ++i) {
    if (!holds(ratios.pairs[i], planted.log_ratios[i])) count.all_cells = 0;
    if (ratios.pairs[i].sure_low > std::exp(planted.log_ratios[i])) count.false_alarm = 1;
    count.cell_width += log_width(ratios.pairs[i]) / cell_count;
  }
  const double log_mean = mean(planted.log_ratios);
  count.mean = holds(ratios.mean, log_mean) ? 1 : 0;
  if (ratios.mean.sure_low > std::exp(log_mean)) count.false_alarm = 1;
  count.mean_width = log_width(ratios.mean);

  const RatioScenario& s = scenario;
  const std::string spread = fmt::format("trials {:.1f} % apart", 100 * s.trial_spread);
  std::vector<std::string> keys;
  if (ratios.spread == TrialSpread::repetitions) {
    keys = {"all",
            fmt::format("{} repetitions", s.repetition_count),
            fmt::format("{:2} cells", s.cell_count),
            fmt::format("{:3} frames", s.frame_count),
            fmt::format("autocorrelation {:.1f}", s.autocorrelation),
            s.heavy_tails ? "heavy tails" : "normal",
            s.ratio_spread > 0 ? "ratios differ" : "one ratio",
            spread,
            fmt::format("{} repetitions, {}", s.repetition_count, spread)};
  } else {
    keys = {
        fmt::format("one trial: {:2} cells, {}", s.cell_count,
                    s.ratio_spread > 0 ? "ratios differ" : "one ratio"),
        fmt::format("one trial: {} cells, {}", s.cell_count < 3 ? "1 or 2" : "3 or more", spread)};
  }
  for (const std::string& key : keys) {
    Count& sum = counts[key];
    sum.run += count.run;
    sum.all_cells += count.all_cells;
    sum.mean += count.mean;
    sum.false_alarm += count.false_alarm;
    sum.cell_width += count.cell_width;
    sum.mean_width += count.mean_width;
  }
}

std::string Coverage::text() const {
  std::string result = fmt::format("{:<46} {:>6} {:>9} {:>6} {:>11} {:>9} {:>9}\n", "", "runs",
                                   "all cells", "mean", "false alarm", "cell +-", "mean +-");
  const auto out = std::back_inserter(result);
  for (const auto& [key, count] : counts)
    fmt::format_to(out, "{:<46} {:>6} {:>9.3f} {:>6.3f} {:>11.3f} {:>7.2f} % {:>7.2f} %\n", key,
                   count.run, count.all_cells / count.run, count.mean / count.run,
                   count.false_alarm / count.run, 100 * std::exp(count.cell_width / count.run),
                   100 * std::exp(count.mean_width / count.run));
  return result;
}

}  // namespace energyprof::analysis::planted
