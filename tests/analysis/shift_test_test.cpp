#include "analysis/shift_test.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "analysis/fft.h"

namespace energyprof::analysis {
namespace {

using Random = std::mt19937_64;

/// Each value is `memory` times the one before plus noise: a series that drifts.
std::vector<double> drifting(std::size_t count, double memory, Random& random) {
  std::normal_distribution<double> noise;
  std::vector<double> values(count);
  double value = noise(random) / std::sqrt(1 - memory * memory);
  for (double& v : values) {
    v = value;
    value = memory * value + noise(random);
  }
  return values;
}

void centre(std::vector<double>& values) {
  double sum = 0;
  for (double v : values) sum += v;
  for (double& v : values) v -= sum / static_cast<double>(values.size());
}

TEST(CircularCorrelator, GivesTheSumsOfAllShifts) {
  Random random(1);
  for (std::size_t n : {1, 2, 3, 7, 64, 100, 257}) {
    SCOPED_TRACE(n);
    const auto x = drifting(n, 0.5, random);
    const auto y = drifting(n, 0.5, random);
    const auto z = drifting(n, 0.9, random);
    const auto sums = CircularCorrelator(x).correlate(y, z);
    for (std::size_t s = 0; s < n; ++s) {
      double first = 0;
      double second = 0;
      for (std::size_t i = 0; i < n; ++i) {
        first += x[i] * y[(i + s) % n];
        second += x[i] * z[(i + s) % n];
      }
      EXPECT_NEAR(sums.first[s], first, 1e-9);
      EXPECT_NEAR(sums.second[s], second, 1e-9);
    }
  }
}

TEST(ShiftTest, FindsADelayedCopyAndItsDelay) {
  Random random(2);
  for (const std::vector<std::size_t>& trials :
       {std::vector<std::size_t>(20, 50), std::vector<std::size_t>(202, 50),
        std::vector<std::size_t>(300, 50), std::vector<std::size_t>{1'000},
        std::vector<std::size_t>{300, 150, 200}}) {
    std::size_t count = 0;
    for (std::size_t length : trials) count += length;
    const auto x = drifting(count, 0.3, random);
    std::vector<double> y(count);
    for (std::size_t i = 0; i < count; ++i) y[i] = i < 3 ? 0 : -x[i - 3];
    const ShiftTest test(trials, {10'000, 6, 1});
    const auto result = ShiftTest::Prepared(test, x).against(y);
    EXPECT_EQ(result.lag, 3);
    EXPECT_LT(result.p_lagged, 0.002);
    EXPECT_GE(result.shift_count, 10'000u);
  }
}

/// How often p is at most 0.05 for pairs of series that have nothing to do with each other.
struct FalseAlarms {
  double plain = 0;
  double lagged = 0;
};
FalseAlarms false_alarms(const std::vector<std::size_t>& trials, double memory, std::size_t lag,
                         int pair_count) {
  std::size_t count = 0;
  for (std::size_t length : trials) count += length;
  const ShiftTest test(trials, {2'000, lag, 1});
  Random random(3);
  FalseAlarms share;
  for (int pair = 0; pair < pair_count; ++pair) {
    auto x = drifting(count, memory, random);
    auto y = drifting(count, memory, random);
    centre(x);
    centre(y);
    const auto result = ShiftTest::Prepared(test, x).against(y);
    share.plain += (result.p <= 0.05 ? 1.0 : 0.0) / pair_count;
    share.lagged += (result.p_lagged <= 0.05 ? 1.0 : 0.0) / pair_count;
  }
  return share;
}

TEST(ShiftTest, GivesFewFalseAlarmsForSeriesThatDrift) {
  // A test that takes values as independent calls half of the pairs of memory 0.9 related. 300
  // pairs: 0.05 with a standard deviation of 0.013.
  for (const auto& trials : {std::vector<std::size_t>(24, 50), std::vector<std::size_t>{1'500},
                             std::vector<std::size_t>{700, 100, 400}}) {
    SCOPED_TRACE(testing::Message() << trials.size() << " trials");
    const FalseAlarms share = false_alarms(trials, 0.9, 4, 300);
    EXPECT_LE(share.plain, 0.09);
    EXPECT_LE(share.lagged, 0.09);
  }
}

TEST(FalseDiscoveryRates, AreThoseOnPaper) {
  // Sorted: 0.01, 0.02, 0.03, 0.5 times 4 / rank = 0.04, 0.04, 0.04, 0.5.
  EXPECT_THAT(false_discovery_rates(std::vector{0.03, 0.5, 0.01, 0.02}),
              testing::ElementsAre(testing::DoubleEq(0.04), testing::DoubleEq(0.5),
                                   testing::DoubleEq(0.04), testing::DoubleEq(0.04)));
  EXPECT_TRUE(false_discovery_rates({}).empty());
}

}  // namespace
}  // namespace energyprof::analysis
