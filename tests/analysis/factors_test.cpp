#include "analysis/factors.h"
#include "tests/sanitized.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace energyprof::analysis {
namespace {

using testing::HasSubstr;

const std::vector<FactorName> two_names{{"nodes"}, {"misses"}};

/// exp of a, b and the response.
FactorCell cell(double a, double b, double response) {
  return {std::exp(response), std::nullopt, {std::exp(a), std::exp(b)}};
}

TEST(Factors, OfAnOrthogonalDesignHaveTheirOwnVariance) {
  // a and b take all combinations of -1 and 1, twice: independent. time = 2 a + b: variances 4
  // and 1.
  std::vector<FactorCell> cells;
  for (int copy = 0; copy < 2; ++copy)
    for (double a : {-1.0, 1.0})
      for (double b : {-1.0, 1.0}) cells.push_back(cell(a, b, 2 * a + b));
  const FactorReport report = explain(two_names, cells);
  EXPECT_NEAR(*report.factors[0].share_of_time_variance, 0.8, 1e-9);
  EXPECT_NEAR(*report.factors[1].share_of_time_variance, 0.2, 1e-9);
  EXPECT_NEAR(*report.explained_time_ratio, 1, 1e-9);
  EXPECT_NEAR(*report.factors[0].variance_inflation, 1, 1e-9);
  EXPECT_EQ(report.factors[0].note, "");
  EXPECT_FALSE(report.factors[0].share_of_energy_variance);
}

TEST(Factors, OfACorrelatedDesignShareByLindemanMerendaGold) {
  // Two factors of correlation r and the response a: alone a explains 1 and b r^2. After the other,
  // a adds 1 - r^2 and b nothing. Shares: (1 + 1 - r^2) / 2 and r^2 / 2.
  std::vector<FactorCell> cells;
  double ab = 0;
  double aa = 0;
  double bb = 0;
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  std::vector<std::pair<double, double>> points;
  double mean_a = 0;
  double mean_b = 0;
  for (int i = 0; i < 40; ++i) {
    const double a = normal(random);
    points.emplace_back(a, 0.6 * a + 0.8 * normal(random));
    mean_a += points.back().first / 40;
    mean_b += points.back().second / 40;
  }
  for (const auto& [a, b] : points) {
    cells.push_back(cell(a, b, a));
    ab += (a - mean_a) * (b - mean_b);
    aa += (a - mean_a) * (a - mean_a);
    bb += (b - mean_b) * (b - mean_b);
  }
  const double r2 = ab * ab / (aa * bb);
  const FactorReport report = explain(two_names, cells);
  EXPECT_NEAR(*report.factors[0].share_of_time_variance, 1 - r2 / 2, 1e-9);
  EXPECT_NEAR(*report.factors[1].share_of_time_variance, r2 / 2, 1e-9);
  EXPECT_NEAR(*report.factors[0].variance_inflation, 1 / (1 - r2), 1e-9);
}

TEST(Factors, ThatRiseTogetherCannotBeToldApart) {
  std::mt19937_64 random(2);
  std::normal_distribution<double> normal;
  std::vector<FactorCell> cells;
  for (int i = 0; i < 20; ++i) {
    const double a = normal(random);
    cells.push_back(cell(a, a + 0.05 * normal(random), a));
  }
  FactorReport report = explain(two_names, cells);
  EXPECT_GT(*report.factors[0].variance_inflation, 10);
  EXPECT_THAT(report.factors[0].note, HasSubstr("cannot be told from misses"));
  EXPECT_EQ(report.notes.size(), 3u) << "both factors, and that energy is unknown";

  for (FactorCell& c : cells) c.value[1] = *c.value[0] * 3;  // a copy
  report = explain(two_names, cells);
  EXPECT_FALSE(report.factors[0].variance_inflation);
  EXPECT_NEAR(*report.factors[0].share_of_time_variance, 0.5, 1e-6);
  EXPECT_NEAR(*report.factors[1].share_of_time_variance, 0.5, 1e-6);
}

TEST(Factors, NeedEnoughCells) {
  std::vector<FactorCell> cells;
  for (int i = 0; i < 5; ++i) cells.push_back(cell(i, i * i, i));
  const FactorReport report = explain(two_names, cells);
  EXPECT_FALSE(report.factors[0].share_of_time_variance);
  EXPECT_THAT(report.notes.front(),
              HasSubstr("Too few cells: 5 cells for 2 factors; 6 are needed"));
}

TEST(Factors, ThatAreUnknownOrConstantAreLeftOut) {
  std::vector<FactorCell> cells;
  for (int i = 0; i < 10; ++i)
    cells.push_back({1.0 + i, 2.0 + i, {1.0 + i, std::nullopt, 5.0, i % 3 == 0 ? -1.0 : 40.0 + i}});
  const std::vector<FactorName> names{{"nodes"}, {"clock"}, {"simd"}, {"temperature", true}};
  const FactorReport report = explain(names, cells);
  EXPECT_TRUE(report.factors[0].share_of_time_variance);
  EXPECT_TRUE(report.factors[0].share_of_energy_variance);
  EXPECT_EQ(report.factors[1].note, "unknown in this run");
  EXPECT_EQ(report.factors[2].note, "the same in every cell");
  EXPECT_TRUE(report.factors[3].share_of_time_variance);
  EXPECT_TRUE(explain({}, {}).factors.empty());
}

TEST(Factors, IntervalsHoldThePlantedShares) {
  // time = 1.5 a + b + noise of 0.5, without a third factor: shares 2.25, 1 and 0 of 3.5. With few
  // cells, too.
  const std::vector<FactorName> names{{"nodes"}, {"misses"}, {"idle talk"}};
  const std::vector<double> truth{2.25 / 3.5, 1 / 3.5, 0};
  for (int cell_count : {9, 60}) {
    std::vector<int> covered(truth.size());
    for (uint64_t seed = 0; seed < test::runs(400); ++seed) {
      std::mt19937_64 random(seed);
      std::normal_distribution<double> normal;
      std::vector<FactorCell> cells;
      for (int i = 0; i < cell_count; ++i) {
        const double a = normal(random);
        const double b = normal(random);
        cells.push_back(cell(a, b, 1.5 * a + b + 0.5 * normal(random)));
        cells.back().value.emplace_back(std::exp(normal(random)));
      }
      const FactorReport report = explain(names, cells);
      for (std::size_t k = 0; k < truth.size(); ++k) {
        const Interval interval = *report.factors[k].time_interval;
        if (interval.low <= truth[k] && truth[k] <= interval.high) ++covered[k];
        EXPECT_GE(interval.low, 0);
        EXPECT_LE(interval.high, 1);
      }
    }
    if (test::is_sanitized) GTEST_SKIP() << "three runs prove nothing";
    for (std::size_t k = 0; k < truth.size(); ++k)
      EXPECT_GE(covered[k], 0.92 * 400) << names[k].name << ", " << cell_count << " cells";
  }
}

}  // namespace
}  // namespace energyprof::analysis
