#include "analysis/ratios.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <span>

#include "planted_ratios.h"
#include "tests/sanitized.h"

namespace energyprof::analysis {
namespace {

using planted::Coverage;
using planted::make_pairs;
using planted::PlantedPairs;
using planted::RatioScenario;

/// `run_count` pairs of runs like `scenario`.
Coverage::Count count(const RatioScenario& scenario, uint64_t run_count) {
  Coverage coverage;
  for (uint64_t seed = 0; seed < test::runs(run_count); ++seed) coverage.add(scenario, seed);
  return coverage.counts.begin()->second;
}

TEST(Ratios, HoldWhateverRepetitionsDifferBy) {
  // Of 300 intervals at 95 % on average 15 miss, with a standard deviation of 3.8; 7.5 alarms are
  // false, with one of 2.7.
  const RatioScenario base{.cell_count = 3, .frame_count = 24, .autocorrelation = 0.5};
  RatioScenario alike = base;
  alike.trial_spread = 0;
  alike.autocorrelation = 0.9;
  RatioScenario apart = base;
  apart.trial_spread = 0.02;
  apart.ratio_spread = 0.1;
  RatioScenario three = base;
  three.repetition_count = 3;
  three.trial_spread = 0.003;
  three.heavy_tails = true;
  for (const RatioScenario& scenario : {alike, apart, three}) {
    SCOPED_TRACE(scenario.trial_spread);
    const Coverage::Count counted = count(scenario, 300);
    if (test::is_sanitized) continue;
    EXPECT_GE(counted.all_cells, 300 - 26);
    EXPECT_GE(counted.mean, 300 - 26);
    EXPECT_LE(counted.false_alarm, 15);
  }
}

TEST(Ratios, OfTheMeanDependOnlyOnHowWellCellsAreKnown) {
  const RatioScenario alike{.cell_count = 12, .ratio_spread = 0};
  RatioScenario apart = alike;
  apart.ratio_spread = 0.3;
  const Ratios one = ratios_of(make_pairs(alike, 1).pairs);
  const Ratios many = ratios_of(make_pairs(apart, 1).pairs);
  const auto width = [](const Ratio& ratio) {
    return std::log(ratio.interval.high / ratio.interval.low);
  };
  EXPECT_NEAR(width(many.mean) / width(one.mean), 1, 0.3);
}

TEST(Ratios, OfOneTrialEachStandOnDifferencesOfCells) {
  const RatioScenario scenario{.repetition_count = 1, .cell_count = 6, .trial_spread = 0.02};
  PlantedPairs planted = make_pairs(scenario, 1);
  for (std::vector<double>& trial : planted.pairs[2].b)
    for (double& value : trial) value *= 2;
  const Ratios ratios = ratios_of(planted.pairs);
  EXPECT_EQ(ratios.spread, TrialSpread::cells);
  for (std::size_t i = 0; i < 6; ++i) EXPECT_EQ(ratios.pairs[i].interval.low > 1, i == 2) << i;

  // Two cells differ by chance alone: nothing is known, and 1 % is assumed.
  planted.pairs.resize(2);
  const Ratios few = ratios_of(planted.pairs);
  EXPECT_EQ(few.spread, TrialSpread::assumed);
  EXPECT_LT(few.pairs[0].interval.low, few.pairs[0].value * 0.98);
}

TEST(Ratios, InvertWhenTheRunsChangePlaces) {
  PlantedPairs planted = make_pairs({.ratio_spread = 0.1}, 1);
  const Ratios there = ratios_of(planted.pairs);
  for (TrialPair& pair : planted.pairs) std::swap(pair.a, pair.b);
  const Ratios back = ratios_of(planted.pairs);
  for (std::size_t i = 0; i < there.pairs.size(); ++i) {
    EXPECT_NEAR(there.pairs[i].value * back.pairs[i].value, 1, 1e-12);
    EXPECT_NEAR(there.pairs[i].interval.low * back.pairs[i].interval.high, 1, 1e-12);
  }
  EXPECT_NEAR(there.mean.interval.high * back.mean.interval.low, 1, 1e-12);
}

TEST(Ratios, ShareTheErrorOfTheGate) {
  const Ratios many = ratios_of(make_pairs({.cell_count = 4}, 1).pairs);
  for (const Ratio& ratio : many.pairs) EXPECT_LT(ratio.sure_low, ratio.interval.low);
  EXPECT_LT(many.mean.sure_low, many.mean.interval.low);
  // A single cell is its own mean: there is nothing to share.
  const Ratios one = ratios_of(make_pairs({.cell_count = 1}, 1).pairs);
  EXPECT_EQ(one.pairs[0].sure_low, one.pairs[0].interval.low);
  EXPECT_EQ(one.mean.interval.low, one.pairs[0].interval.low);
}

TEST(Ratios, OfEstimatesHoldAsOftenAsTheirFreedomAllows) {
  // Two estimates with 4 degrees of freedom each: a chi-square of 4, over 4, times the variance.
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  const double errors[] = {0.05, 0.02};
  int held = 0;
  constexpr int run_count = 4'000;
  for (int run = 0; run < run_count; ++run) {
    LogPair pair;
    for (int side = 0; side < 2; ++side) {
      double squares = 0;
      for (int i = 0; i < 4; ++i) squares += std::pow(normal(random), 2);
      (side == 0 ? pair.a : pair.b) = {errors[side] * normal(random),
                                       std::pow(errors[side], 2) * squares / 4, 4};
    }
    const Ratio ratio = ratios_of(std::span(&pair, 1)).front();
    held += ratio.interval.low <= 1 && 1 <= ratio.interval.high ? 1 : 0;
  }
  EXPECT_GE(held, 0.935 * run_count);
  EXPECT_LE(held, 0.97 * run_count);
}

}  // namespace
}  // namespace energyprof::analysis
