#include "analysis/odds.h"

#include <algorithm>
#include <boost/math/special_functions/gamma.hpp>
#include <boost/math/tools/roots.hpp>
#include <cassert>
#include <cmath>
#include <functional>
#include <vector>

namespace energyprof::analysis {
namespace {

/// The distribution of the count of "both", given the totals and an odds ratio.
class Conditional {
 public:
  explicit Conditional(const FourCounts& counts) {
    const int64_t first = counts.both + counts.first_only;
    const int64_t second = counts.both + counts.second_only;
    const int64_t others = counts.second_only + counts.neither;  // without the first
    low_ = std::max<int64_t>(0, second - others);
    const int64_t high = std::min(first, second);
    for (int64_t x = low_; x <= high; ++x)
      log_weight_.push_back(log_choose(first, x) + log_choose(others, second - x));
    observed_ = static_cast<std::size_t>(counts.both - low_);
  }

  [[nodiscard]] std::size_t observed() const { return observed_; }
  [[nodiscard]] std::size_t last() const { return log_weight_.size() - 1; }

  /// Probability of each count, from the smallest possible on.
  [[nodiscard]] std::vector<double> probabilities(double log_odds) const {
    std::vector<double> value(log_weight_.size());
    for (std::size_t i = 0; i < value.size(); ++i)
      value[i] = log_weight_[i] + static_cast<double>(i) * log_odds;
    const double top = *std::max_element(value.begin(), value.end());
    double sum = 0;
    for (double& v : value) sum += (v = std::exp(v - top));
    for (double& v : value) v /= sum;
    return value;
  }
  [[nodiscard]] double mean(double log_odds) const {
    const std::vector<double> p = probabilities(log_odds);
    double sum = 0;
    for (std::size_t i = 0; i < p.size(); ++i) sum += static_cast<double>(i) * p[i];
    return sum;
  }
  /// P(count >= observed).
  [[nodiscard]] double at_least(double log_odds) const {
    const std::vector<double> p = probabilities(log_odds);
    double sum = 0;
    for (std::size_t i = observed_; i < p.size(); ++i) sum += p[i];
    return sum;
  }
  /// P(count <= observed).
  [[nodiscard]] double at_most(double log_odds) const {
    const std::vector<double> p = probabilities(log_odds);
    double sum = 0;
    for (std::size_t i = 0; i <= observed_; ++i) sum += p[i];
    return sum;
  }

 private:
  static double log_choose(int64_t n, int64_t k) {
    const auto log_factorial = [](int64_t m) {
      return boost::math::lgamma(static_cast<double>(m) + 1);
    };
    return log_factorial(n) - log_factorial(k) - log_factorial(n - k);
  }

  int64_t low_ = 0;
  std::vector<double> log_weight_;
  std::size_t observed_ = 0;
};

/// The odds ratio at which a monotone function of its logarithm is 0.
double solve(const std::function<double(double)>& function) {
  double low = -1;
  double high = 1;
  while (function(low) * function(high) > 0 && high < 600) {
    low *= 2;
    high *= 2;
  }
  boost::uintmax_t step_count = 200;
  const auto root = boost::math::tools::toms748_solve(
      function, low, high, boost::math::tools::eps_tolerance<double>(40), step_count);
  return std::exp((root.first + root.second) / 2);
}

double fisher_p(const Conditional& distribution) {
  const std::vector<double> chance = distribution.probabilities(0);
  // Equal on paper may differ by rounding; the factor is R's.
  const double limit = chance[distribution.observed()] * (1 + 1e-7);
  double p = 0;
  for (double c : chance)
    if (c <= limit) p += c;
  return std::min(p, 1.0);
}

}  // namespace

std::optional<OddsRatio> odds_ratio(const FourCounts& counts) {
  assert(counts.both >= 0 && counts.first_only >= 0 && counts.second_only >= 0 &&
         counts.neither >= 0);
  if (counts.both + counts.first_only == 0 || counts.both + counts.second_only == 0 ||
      counts.second_only + counts.neither == 0 || counts.first_only + counts.neither == 0)
    return std::nullopt;
  const Conditional distribution(counts);
  constexpr double tail = 0.025;
  const bool least = distribution.observed() == 0;
  const bool most = distribution.observed() == distribution.last();
  OddsRatio result;
  result.p = fisher_p(distribution);
  if (!least) result.low = solve([&](double b) { return distribution.at_least(b) - tail; });
  if (!most) result.high = solve([&](double b) { return distribution.at_most(b) - tail; });
  if (least) {
    result.value = 0;
  } else if (most) {
    result.value = solve([&](double b) { return distribution.at_least(b) - 0.5; });
  } else {
    const auto seen = static_cast<double>(distribution.observed());
    result.value = solve([&](double b) { return distribution.mean(b) - seen; });
  }
  return result;
}

}  // namespace energyprof::analysis
