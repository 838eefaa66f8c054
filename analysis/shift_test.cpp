#include "analysis/shift_test.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numeric>
#include <random>

namespace energyprof::analysis {
namespace {

constexpr std::size_t min_mean_trial_length = 4;
constexpr std::size_t max_rotation_count = 32;
constexpr std::size_t min_piece_count = 6;
constexpr std::size_t min_piece_length = 32;
/// Shorter trials are correlated product by product, which is faster.
constexpr std::size_t min_transformed_length = 96;

/// A sum that differs only by rounding counts as equal.
bool reaches(double size, double observed) { return size >= observed * (1 - 1e-9); }

/// The largest of each `width` consecutive sizes on a circle: element i is of those from i on.
std::vector<double> circular_maximum(const std::vector<double>& sums, std::size_t width) {
  const std::size_t n = sums.size();
  std::vector<double> largest(n);
  std::transform(sums.begin(), sums.end(), largest.begin(), [](double v) { return std::fabs(v); });
  std::vector<double> next(n);
  for (std::size_t have = 1; have < width;) {
    const std::size_t step = std::min(have, width - have);
    for (std::size_t i = 0; i < n; ++i) next[i] = std::max(largest[i], largest[(i + step) % n]);
    largest.swap(next);
    have += step;
  }
  return largest;
}

double root_mean_square(std::span<const double> values) {
  if (values.empty()) return 0;
  const double squares = std::inner_product(values.begin(), values.end(), values.begin(), 0.0);
  return std::sqrt(squares / static_cast<double>(values.size()));
}

/// The ratio of the 95 % quantiles of sizes that belong together.
double widening_of(std::vector<double> largest, std::vector<double> single) {
  if (single.empty()) return 1;
  const auto at = static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(single.size() - 1));
  for (std::vector<double>* sizes : {&largest, &single})
    std::nth_element(sizes->begin(), sizes->begin() + at, sizes->end());
  const auto place = static_cast<std::size_t>(at);
  return single[place] > 0 ? largest[place] / single[place] : 1;
}

}  // namespace

ShiftTest::ShiftTest(std::vector<std::size_t> trial_lengths, Config config) : config_(config) {
  count_ = std::accumulate(trial_lengths.begin(), trial_lengths.end(), std::size_t{0});
  // Of the whole run every shift counts but the nearest: a fiftieth of all at most on each side.
  const std::size_t near =
      std::min(count_ / 50, 2 * count_ / std::max<std::size_t>(1, trial_lengths.size()));
  const bool is_short = count_ < config_.shift_count + 2 * std::max(near, 2 * config_.max_lag) + 1;
  const std::size_t piece_length = std::max(count_ / min_piece_count, min_piece_length);
  for (std::size_t length : trial_lengths) {
    std::size_t piece_count = 1;
    if (is_short && trial_lengths.size() < 4)
      piece_count = std::max<std::size_t>(1, length / piece_length);
    for (std::size_t piece = 0; piece < piece_count; ++piece)
      lengths_.push_back((piece + 1) * length / piece_count - piece * length / piece_count);
  }
  std::size_t begin = 0;
  for (std::size_t length : lengths_) {
    begins_.push_back(begin);
    begin += length;
  }
  const bool tiny_trials = count_ < min_mean_trial_length * lengths_.size();
  whole_run_ = !is_short || lengths_.size() < 2 || tiny_trials;
}

ShiftTest::Prepared::Prepared(const ShiftTest& test, std::span<const double> x)
    : test_(test), x_(x.begin(), x.end()) {
  assert(x.size() == test.count_);
  if (test_.whole_run_) {
    whole_ = std::make_unique<CircularCorrelator>(x_);
    return;
  }
  for (std::size_t trial = 0; trial < test_.lengths_.size(); ++trial) {
    const std::size_t length = test_.lengths_[trial];
    by_trial_.push_back(length < min_transformed_length
                            ? nullptr
                            : std::make_unique<CircularCorrelator>(
                                  std::span(x_).subspan(test_.begins_[trial], length)));
  }
}

ShiftTest::Result ShiftTest::Prepared::against(std::span<const double> y,
                                               double turned_length) const {
  if (test_.whole_run_) return test_.judge_whole(whole_->correlate(y), turned_length);
  return in_trials(y, turned_length);
}

std::pair<ShiftTest::Result, ShiftTest::Result> ShiftTest::Prepared::against(
    std::span<const double> first, std::span<const double> second, double first_turned_length,
    double second_turned_length) const {
  if (!test_.whole_run_)
    return {in_trials(first, first_turned_length), in_trials(second, second_turned_length)};
  const CircularCorrelator::Pair sums = whole_->correlate(first, second);
  return {test_.judge_whole(sums.first, first_turned_length),
          test_.judge_whole(sums.second, second_turned_length)};
}

std::vector<double> ShiftTest::turned(std::span<const double> y, std::size_t draw,
                                      std::size_t draw_count) const {
  std::vector<double> result(y.size());
  if (whole_run_) {
    const std::size_t shift = (draw + 1) * y.size() / (draw_count + 1);
    for (std::size_t i = 0; i < y.size(); ++i) result[i] = y[(i + shift) % y.size()];
    return result;
  }
  std::mt19937_64 random(config_.seed + draw);
  const std::size_t rotation = draw * lengths_.size() / draw_count;
  for (std::size_t trial = 0; trial < lengths_.size(); ++trial) {
    const std::size_t partner = (trial + rotation) % lengths_.size();
    const std::size_t length = lengths_[partner];
    const std::size_t turn = random() % length;
    for (std::size_t i = 0; i < lengths_[trial]; ++i)
      result[begins_[trial] + i] = y[begins_[partner] + (i + turn) % length];
  }
  return result;
}

ShiftTest::Result ShiftTest::judge_whole(const std::vector<double>& sums,
                                         double turned_length) const {
  Result result;
  const std::size_t n = sums.size();
  if (n < 2) return result;
  // A series shifted by less than what its values depend on each other is still itself: the nearest
  // shifts are no chance events. At most a fiftieth of all is left out on each side.
  const std::size_t lag = std::min(config_.max_lag, (n - 1) / 8);
  const std::size_t near = std::max(std::min(n / 50, 2 * count_ / lengths_.size()), 2 * lag);
  const std::vector<double> largest = circular_maximum(sums, 2 * lag + 1);
  // largest[i] is of the lags from i on, so that of the lags around s begins at s - lag.
  const auto around = [&](std::size_t s) { return largest[(s + n - lag) % n]; };
  const double observed = std::fabs(sums[0]) * turned_length;
  const double observed_lagged = around(0) * turned_length;
  for (std::size_t k = 0; k <= 2 * lag; ++k) {
    const std::ptrdiff_t at = static_cast<std::ptrdiff_t>(k) - static_cast<std::ptrdiff_t>(lag);
    const auto index = static_cast<std::size_t>(at + static_cast<std::ptrdiff_t>(n)) % n;
    const auto best = static_cast<std::size_t>(result.lag + static_cast<std::ptrdiff_t>(n)) % n;
    if (std::fabs(sums[index]) > std::fabs(sums[best])) result.lag = at;
    result.sums.push_back(sums[index]);
  }
  std::size_t reached = 0;
  std::size_t reached_lagged = 0;
  std::vector<double> single;
  std::vector<double> over_lags;
  const std::size_t stride = 1 + n / 10'000;  // enough for a quantile
  for (std::size_t s = near + 1; s + near < n; ++s) {
    ++result.shift_count;
    if (s % stride == 0) {
      single.push_back(std::fabs(sums[s]));
      over_lags.push_back(around(s));
    }
    if (reaches(std::fabs(sums[s]), observed)) ++reached;
    if (reaches(around(s), observed_lagged)) ++reached_lagged;
  }
  const double all = static_cast<double>(result.shift_count) + 1;
  result.p = static_cast<double>(reached + 1) / all;
  result.p_lagged = static_cast<double>(reached_lagged + 1) / all;
  result.spread = root_mean_square(single) / turned_length;
  result.widening = widening_of(std::move(over_lags), std::move(single));
  return result;
}

/// The sums of products of one trial with `partner`'s part of y, for each turn of the latter.
std::vector<double> ShiftTest::Prepared::turned(std::size_t trial, std::size_t partner,
                                                std::span<const double> y) const {
  const std::size_t length = test_.lengths_[partner];
  const auto x = std::span(x_).subspan(test_.begins_[trial], test_.lengths_[trial]);
  const auto part = y.subspan(test_.begins_[partner], length);
  if (by_trial_[trial] && x.size() == length) return by_trial_[trial]->correlate(part);
  // A trial longer than its partner meets it more than once: folded onto its length.
  std::vector<double> folded(length, 0.0);
  for (std::size_t i = 0; i < x.size(); ++i) folded[i % length] += x[i];
  if (length >= min_transformed_length) return CircularCorrelator(folded).correlate(part);
  std::vector<double> sums(length, 0.0);
  for (std::size_t i = 0; i < length; ++i) {
    if (folded[i] == 0) continue;
    const std::size_t tail = length - i;
    for (std::size_t s = 0; s < tail; ++s) sums[s] += folded[i] * part[i + s];
    for (std::size_t s = tail; s < length; ++s) sums[s] += folded[i] * part[s - tail];
  }
  return sums;
}

ShiftTest::Result ShiftTest::Prepared::in_trials(std::span<const double> y,
                                                 double turned_length) const {
  const std::vector<std::size_t>& lengths = test_.lengths_;
  const std::size_t trial_count = lengths.size();
  const std::size_t lag = test_.config_.max_lag;
  const std::size_t width = 2 * lag + 1;

  // Tables that may be read from any turn on without wrapping: element k is of turn k - lag.
  std::vector<std::vector<double>> tables(trial_count);
  const auto tabulate = [&](std::size_t rotation) {
    for (std::size_t trial = 0; trial < trial_count; ++trial) {
      const std::size_t partner = (trial + rotation) % trial_count;
      const std::vector<double> sums = turned(trial, partner, y);
      const std::size_t n = sums.size();
      std::vector<double>& table = tables[trial];
      table.resize(n + 2 * lag);
      for (std::size_t k = 0; k < table.size(); ++k) table[k] = sums[(k + n * width - lag) % n];
    }
  };

  std::vector<double> sums(width);
  const auto largest = [&] {
    double size = 0;
    for (double sum : sums) size = std::max(size, std::fabs(sum));
    return size;
  };

  tabulate(0);
  for (const std::vector<double>& table : tables)
    for (std::size_t l = 0; l < width; ++l) sums[l] += table[l];
  Result result;
  const double observed = std::fabs(sums[lag]) * turned_length;
  const double observed_lagged = largest() * turned_length;
  std::size_t best = lag;
  for (std::size_t l = 0; l < width; ++l)
    if (std::fabs(sums[l]) > std::fabs(sums[best])) best = l;
  result.lag = static_cast<std::ptrdiff_t>(best) - static_cast<std::ptrdiff_t>(lag);
  result.sums = sums;

  const std::size_t rotation_count = std::min(trial_count, max_rotation_count);
  const std::size_t turns_each = (test_.config_.shift_count + rotation_count - 1) / rotation_count;
  std::mt19937_64 random(test_.config_.seed);
  std::size_t reached = 0;
  std::size_t reached_lagged = 0;
  std::vector<double> single;
  std::vector<double> over_lags;
  for (std::size_t r = 0; r < rotation_count; ++r) {
    if (r > 0) tabulate(r * trial_count / rotation_count);
    for (std::size_t turn = 0; turn < turns_each; ++turn) {
      std::fill(sums.begin(), sums.end(), 0.0);
      for (const std::vector<double>& table : tables) {
        const double* row = table.data() + random() % (table.size() - 2 * lag);
        for (std::size_t l = 0; l < width; ++l) sums[l] += row[l];
      }
      ++result.shift_count;
      single.push_back(std::fabs(sums[lag]));
      over_lags.push_back(largest());
      if (reaches(single.back(), observed)) ++reached;
      if (reaches(over_lags.back(), observed_lagged)) ++reached_lagged;
    }
  }
  const double all = static_cast<double>(result.shift_count) + 1;
  result.p = static_cast<double>(reached + 1) / all;
  result.p_lagged = static_cast<double>(reached_lagged + 1) / all;
  result.spread = root_mean_square(single) / turned_length;
  result.widening = widening_of(std::move(over_lags), std::move(single));
  return result;
}

std::vector<double> false_discovery_rates(std::span<const double> p) {
  std::vector<std::size_t> order(p.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return p[a] < p[b]; });
  std::vector<double> q(p.size());
  double smallest = 1;
  for (std::size_t rank = order.size(); rank-- > 0;) {
    const double adjusted =
        p[order[rank]] * static_cast<double>(p.size()) / static_cast<double>(rank + 1);
    smallest = std::min(smallest, adjusted);
    q[order[rank]] = std::max(smallest, p[order[rank]]);  // rounding aside, it is
  }
  return q;
}

}  // namespace energyprof::analysis
