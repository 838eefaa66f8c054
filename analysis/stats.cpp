#include "analysis/stats.h"

#include <algorithm>
#include <boost/math/distributions/binomial.hpp>
#include <boost/math/distributions/students_t.hpp>
#include <cassert>
#include <cmath>
#include <numeric>
#include <vector>

namespace energyprof::analysis {
namespace {

std::vector<double> sorted(std::span<const double> values) {
  std::vector<double> copy(values.begin(), values.end());
  std::sort(copy.begin(), copy.end());
  return copy;
}

double quantile_of_sorted(std::span<const double> ordered, double probability) {
  const double position = probability * static_cast<double>(ordered.size() - 1);
  const auto below = static_cast<std::size_t>(position);
  if (below + 1 >= ordered.size()) return ordered.back();
  const double weight = position - static_cast<double>(below);
  return ordered[below] + weight * (ordered[below + 1] - ordered[below]);
}

}  // namespace

double quantile(std::span<const double> values, double probability) {
  assert(!values.empty() && probability >= 0 && probability <= 1);
  // As quantile_of_sorted(), without sorting what is not asked for.
  std::vector<double> parted(values.begin(), values.end());
  const double position = probability * static_cast<double>(parted.size() - 1);
  const auto below = static_cast<std::size_t>(position);
  const auto at = parted.begin() + static_cast<std::ptrdiff_t>(below);
  std::nth_element(parted.begin(), at, parted.end());
  if (below + 1 >= parted.size()) return *at;
  const double next = *std::min_element(at + 1, parted.end());
  return *at + (position - static_cast<double>(below)) * (next - *at);
}

double median(std::span<const double> values) { return quantile(values, 0.5); }

double mean(std::span<const double> values) {
  assert(!values.empty());
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

double truncated_mean(std::span<const double> values, double truncate) {
  assert(!values.empty() && truncate >= 0 && truncate < 1);
  std::vector<double> parted(values.begin(), values.end());
  // A share that is a whole number of values on paper stays one in binary.
  const double exact = static_cast<double>(parted.size()) * truncate / 2;
  const auto dropped = static_cast<std::ptrdiff_t>(std::floor(exact + 1e-9));
  const auto kept_begin = parted.begin() + dropped;
  const auto kept_end = parted.end() - dropped;
  std::nth_element(parted.begin(), kept_begin, parted.end());
  if (dropped > 0) std::nth_element(kept_begin, kept_end, parted.end());
  return mean({kept_begin, kept_end});
}

std::optional<double> stddev(std::span<const double> values) {
  if (values.size() < 2) return std::nullopt;
  const double centre = mean(values);
  double sum = 0;
  for (double value : values) sum += (value - centre) * (value - centre);
  return std::sqrt(sum / static_cast<double>(values.size() - 1));
}

double t_reach(double freedom, double level) {
  const boost::math::students_t t(std::clamp(freedom, 1.0, 1e6));
  return boost::math::quantile(boost::math::complement(t, (1 - level) / 2));
}

std::optional<Interval> median_interval(std::span<const double> values, double level) {
  assert(level > 0 && level < 1);
  if (values.empty()) return std::nullopt;
  const boost::math::binomial below_median(static_cast<double>(values.size()), 0.5);
  const double tail = (1 - level) / 2;
  // P(true median < k-th smallest, from 0) = P(at most k values below it): the largest such k.
  if (cdf(below_median, 0.0) > tail) return std::nullopt;
  double rank = std::floor(boost::math::quantile(below_median, tail));
  while (cdf(below_median, rank) > tail) --rank;
  const std::vector<double> ordered = sorted(values);
  const auto low = static_cast<std::size_t>(rank);
  return Interval{ordered[low], ordered[ordered.size() - 1 - low]};
}

std::size_t block_of(std::size_t count) {
  std::size_t block = 1;
  while (block * block * block < count) ++block;
  return block;
}

void resample_blocks(std::span<const double> values, std::size_t block, std::mt19937_64& random,
                     std::span<double> out) {
  assert(!values.empty() && block > 0);
  std::size_t at = 0;
  for (std::size_t i = 0; i < out.size(); ++i) {
    at = i % block == 0 ? random() % values.size() : (at + 1) % values.size();
    out[i] = values[at];
  }
}

Interval percentile_interval(std::span<const double> replicates, double level) {
  assert(!replicates.empty());
  const std::vector<double> ordered = sorted(replicates);
  const double tail = (1 - level) / 2;
  return {quantile_of_sorted(ordered, tail), quantile_of_sorted(ordered, 1 - tail)};
}

}  // namespace energyprof::analysis
