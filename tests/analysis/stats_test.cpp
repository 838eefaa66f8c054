#include "analysis/stats.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

namespace energyprof::analysis {
namespace {

using Values = std::vector<double>;

TEST(Stats, QuantileInterpolatesBetweenOrderStatistics) {
  // Type 7: position p (n - 1) = 0.75 between 1 and 2; the order of the input does not matter.
  EXPECT_DOUBLE_EQ(quantile(Values{4, 1, 3, 2}, 0.25), 1.75);
  EXPECT_DOUBLE_EQ(quantile(Values{4, 1, 3, 2}, 0), 1);
  EXPECT_DOUBLE_EQ(quantile(Values{4, 1, 3, 2}, 1), 4);
  EXPECT_DOUBLE_EQ(quantile(Values{7}, 0.9), 7);
}

TEST(Stats, MedianOfEvenCountIsTheMiddleOfTheTwo) {
  EXPECT_DOUBLE_EQ(median(Values{1, 9, 3, 5}), 4);
  EXPECT_DOUBLE_EQ(median(Values{9, 1, 3}), 3);
}

TEST(Stats, TruncatedMeanDropsHalfTheShareAtEachEnd) {
  // 20 values, 10 %: one at each end; 2..19 have the mean 10.5.
  Values values(20);
  std::iota(values.begin(), values.end(), 1.0);
  values.back() = 1e6;
  EXPECT_DOUBLE_EQ(truncated_mean(values, 0.10), 10.5);
  // 64 values, 10 %: floor(3.2) = 3 at each end.
  Values paper(64, 1.0);
  for (int i = 0; i < 3; ++i) paper[static_cast<std::size_t>(i)] = 1e9;
  EXPECT_DOUBLE_EQ(truncated_mean(paper, 0.10), 1.0);
  paper[3] = 59.0;  // the fourth is one of the 58 kept: (57 * 1 + 59) / 58 = 2
  EXPECT_DOUBLE_EQ(truncated_mean(paper, 0.10), 2.0);
}

TEST(Stats, TruncatedMeanKeepsEverythingOfFewValues) {
  EXPECT_DOUBLE_EQ(truncated_mean(Values{1, 2, 9}, 0.10), 4);
  EXPECT_DOUBLE_EQ(truncated_mean(Values{5}, 0.99), 5);
}

TEST(Stats, StddevDividesByOneLess) {
  // Deviations from 5: 9 + 1 + 1 + 1 + 0 + 0 + 4 + 16 = 32; 32 / 7.
  EXPECT_DOUBLE_EQ(*stddev(Values{2, 4, 4, 4, 5, 5, 7, 9}), std::sqrt(32.0 / 7));
  EXPECT_EQ(stddev(Values{3}), std::nullopt);
  EXPECT_EQ(stddev(Values{}), std::nullopt);
  EXPECT_DOUBLE_EQ(*stddev(Values{3, 3}), 0);
}

TEST(Stats, MedianIntervalIsAPairOfOrderStatistics) {
  // n = 10: P(at most 1 below) = 11 / 1024 < 2.5 %, at most 2: 56 / 1024 > 2.5 %: second and ninth.
  const Values ten{10, 9, 8, 7, 6, 5, 4, 3, 2, 1};
  const auto interval = median_interval(ten);
  ASSERT_TRUE(interval);
  EXPECT_DOUBLE_EQ(interval->low, 2);
  EXPECT_DOUBLE_EQ(interval->high, 9);
}

TEST(Stats, MedianIntervalNeedsSixValuesForNinetyFivePercent) {
  // 2 / 2^5 = 6.25 % > 5 %; 2 / 2^6 = 3.1 % < 5 %.
  EXPECT_FALSE(median_interval(Values{1, 2, 3, 4, 5}));
  const auto six = median_interval(Values{1, 2, 3, 4, 5, 6});
  ASSERT_TRUE(six);
  EXPECT_DOUBLE_EQ(six->low, 1);
  EXPECT_DOUBLE_EQ(six->high, 6);
  EXPECT_FALSE(median_interval(Values{}));
}

TEST(Stats, MedianIntervalCoversAsOftenAsItSays) {
  std::mt19937_64 random(7);
  std::exponential_distribution<double> skewed;
  int covered = 0;
  constexpr int rounds = 2000;
  for (int round = 0; round < rounds; ++round) {
    Values values(25);
    for (double& value : values) value = skewed(random);
    const auto interval = median_interval(values);
    covered += interval->low <= std::log(2.0) && std::log(2.0) <= interval->high;
  }
  // n = 25 gives 95.67 %; four standard errors of 2000 rounds are 1.8 %.
  EXPECT_NEAR(static_cast<double>(covered) / rounds, 0.9567, 0.018);
}

TEST(Stats, ResamplingIsTheSameForTheSameSeed) {
  const Values values{1, 2, 3, 4, 5, 6, 7, 8};
  Values first(8), second(8), third(8);
  std::mt19937_64 a(3), b(3), c(4);
  resample_blocks(values, 2, a, first);
  resample_blocks(values, 2, b, second);
  resample_blocks(values, 2, c, third);
  EXPECT_EQ(first, second);
  EXPECT_NE(first, third);
}

TEST(Stats, ResamplingKeepsNeighboursTogether) {
  // Blocks of ceil(cbrt(27)) = 3 that may run on from 26 to 0.
  Values values(27);
  std::iota(values.begin(), values.end(), 0.0);
  Values out(27);
  std::mt19937_64 random(1);
  resample_blocks(values, block_of(27), random, out);
  for (std::size_t i = 0; i < out.size(); ++i)
    if (i % 3 != 0) {
      EXPECT_DOUBLE_EQ(out[i], std::fmod(out[i - 1] + 1, 27));
    }
}

TEST(Stats, PercentileIntervalLeavesOutTheTails) {
  Values replicates(1001);
  std::iota(replicates.begin(), replicates.end(), 0.0);
  const Interval interval = percentile_interval(replicates);
  EXPECT_NEAR(interval.low, 25, 1e-9);
  EXPECT_NEAR(interval.high, 975, 1e-9);
}

RC_GTEST_PROP(StatsProperty, CentresLieBetweenTheExtremes, ()) {
  const auto values = *rc::gen::nonEmpty(rc::gen::container<Values>(
      rc::gen::map(rc::gen::inRange(-1000, 1000), [](int i) { return i * 0.5; })));
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  const double slack = 1e-9;
  for (double centre : {median(values), mean(values), truncated_mean(values, 0.3)})
    RC_ASSERT(centre >= *low - slack && centre <= *high + slack);
  const auto interval = median_interval(values);
  if (interval) RC_ASSERT(interval->low <= median(values) && median(values) <= interval->high);
}

}  // namespace
}  // namespace energyprof::analysis
