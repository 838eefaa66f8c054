#include "analysis/odds.h"

#include <gtest/gtest.h>

#include <cmath>

namespace energyprof::analysis {
namespace {

TEST(Odds, AreThoseOfTheLadyTastingTea) {
  // Given the totals, 0 to 4 cups right have the weights 1, 16 w, 36 w^2, 16 w^3, w^4.
  const auto odds = odds_ratio({3, 1, 1, 3});
  ASSERT_TRUE(odds);
  const auto sum = [](double w) {
    return 1 + 16 * w + 36 * w * w + 16 * std::pow(w, 3) + std::pow(w, 4);
  };
  const auto mean = [&](double w) {
    return (16 * w + 72 * w * w + 48 * std::pow(w, 3) + 4 * std::pow(w, 4)) / sum(w);
  };
  EXPECT_NEAR(mean(odds->value), 3, 1e-9);
  EXPECT_NEAR(odds->value, 6.4083, 1e-4) << "as R's fisher.test";
  EXPECT_NEAR((16 * std::pow(odds->low, 3) + std::pow(odds->low, 4)) / sum(odds->low), 0.025, 1e-9);
  EXPECT_NEAR(1 - std::pow(*odds->high, 4) / sum(*odds->high), 0.025, 1e-9);
  EXPECT_NEAR(odds->p, 34.0 / 70, 1e-9);
}

TEST(Odds, AreThoseOfFishersConvictedTwins) {
  // R: fisher.test(matrix(c(2, 10, 15, 3), 2)); it looks for the bounds less exactly.
  const auto odds = odds_ratio({2, 10, 15, 3});
  ASSERT_TRUE(odds);
  EXPECT_NEAR(odds->value, 0.04693661, 1e-7);
  EXPECT_NEAR(odds->low, 0.003325764, 2e-5);
  EXPECT_NEAR(*odds->high, 0.363182271, 2e-5);
  EXPECT_NEAR(odds->p, 0.0005367241, 1e-8);
}

TEST(Odds, HaveNoUpperBoundWhereNothingSpeaksAgainstIt) {
  // One of two frames is an outlier, one is throttled, and it is the same: given the totals both
  // tables have weight 1 and w, so P(both) = w / (1 + w). That is 0.025 at w = 1/39, 1/2 at 1.
  const auto odds = odds_ratio({1, 0, 0, 1});
  ASSERT_TRUE(odds);
  EXPECT_NEAR(odds->low, 1.0 / 39, 1e-9);
  EXPECT_NEAR(odds->value, 1, 1e-9);
  EXPECT_FALSE(odds->high);
  EXPECT_NEAR(odds->p, 1, 1e-12);
}

TEST(Odds, OfNoneTogetherAreZero) {
  const auto odds = odds_ratio({0, 1, 1, 0});
  ASSERT_TRUE(odds);
  EXPECT_EQ(odds->value, 0);
  EXPECT_EQ(odds->low, 0);
  EXPECT_NEAR(*odds->high, 39, 1e-7);
}

TEST(Odds, SayNothingWithoutATotal) {
  EXPECT_FALSE(odds_ratio({0, 0, 5, 20}));
  EXPECT_FALSE(odds_ratio({0, 5, 0, 20}));
  EXPECT_FALSE(odds_ratio({5, 0, 20, 0}));
  EXPECT_FALSE(odds_ratio({0, 0, 0, 0}));
}

TEST(Odds, OfManyFramesAreCloseToTheCrossProduct) {
  const auto odds = odds_ratio({400, 600, 9'600, 89'400});
  ASSERT_TRUE(odds);
  const double cross_product = 400.0 * 89'400 / (600.0 * 9'600);
  EXPECT_NEAR(odds->value, cross_product, 0.01 * cross_product);
  // Woolf's interval, right for large counts: 1.96 times sqrt of the sum of 1 / count.
  const double reach = 1.96 * std::sqrt(1.0 / 400 + 1.0 / 600 + 1.0 / 9'600 + 1.0 / 89'400);
  EXPECT_NEAR(odds->low, cross_product * std::exp(-reach), 0.01 * cross_product);
  EXPECT_NEAR(*odds->high, cross_product * std::exp(reach), 0.02 * cross_product);
  EXPECT_LT(odds->p, 1e-100);
}

}  // namespace
}  // namespace energyprof::analysis
