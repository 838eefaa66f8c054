#include "analysis/factors.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <boost/math/distributions/beta.hpp>
#include <cmath>
#include <numeric>
#include <span>

#include "analysis/format.h"

namespace energyprof::analysis {
namespace {

constexpr std::size_t max_factor_count = 12;
/// What is left of a factor, given others, below which it is a copy of them.
constexpr double copy_ratio = 1e-8;

/// Correlations of the factors with each other and with a response.
struct CorrelationMatrix {
  std::size_t count = 0;
  std::vector<double> between;  // row by row
  std::vector<double> with;
};

using Row = std::vector<double>;  // the factors, then the response

std::optional<CorrelationMatrix> correlation_matrix(const std::vector<Row>& rows,
                                                    const std::vector<std::size_t>& drawn) {
  const std::size_t width = rows.front().size();
  const auto n = static_cast<double>(drawn.size());
  Row centre(width, 0.0);
  for (std::size_t i : drawn)
    for (std::size_t k = 0; k < width; ++k) centre[k] += rows[i][k] / n;
  std::vector<double> sums(width * width, 0.0);
  for (std::size_t i : drawn)
    for (std::size_t a = 0; a < width; ++a)
      for (std::size_t b = 0; b <= a; ++b)
        sums[a * width + b] += (rows[i][a] - centre[a]) * (rows[i][b] - centre[b]);
  if (sums.back() <= 0) return std::nullopt;
  CorrelationMatrix result;
  result.count = width - 1;
  result.between.assign(result.count * result.count, 0.0);
  result.with.assign(result.count, 0.0);
  const auto size = [&](std::size_t a) { return std::sqrt(sums[a * width + a]); };
  for (std::size_t a = 0; a < width; ++a)
    for (std::size_t b = 0; b <= a; ++b) {
      const double both = size(a) * size(b);
      // A factor that a draw left constant explains nothing in it.
      const double r = both > 0 ? sums[a * width + b] / both : (a == b ? 1.0 : 0.0);
      if (a == result.count && b < result.count) result.with[b] = r;
      if (a < result.count)
        result.between[a * result.count + b] = result.between[b * result.count + a] = r;
    }
  return result;
}

/// R^2 of the response on the factors whose bits are set: by sweeping them one after the other,
/// skipping those that the earlier ones make up.
double explained(const CorrelationMatrix& c, std::size_t set) {
  std::vector<std::size_t> members;
  for (std::size_t k = 0; k < c.count; ++k)
    if ((set >> k & 1) != 0) members.push_back(k);
  const std::size_t n = members.size();
  std::vector<double> matrix(n * n);
  std::vector<double> right(n);
  for (std::size_t a = 0; a < n; ++a) {
    for (std::size_t b = 0; b < n; ++b)
      matrix[a * n + b] = c.between[members[a] * c.count + members[b]];
    right[a] = c.with[members[a]];
  }
  double sum = 0;
  for (std::size_t k = 0; k < n; ++k) {
    const double pivot = matrix[k * n + k];
    if (pivot < copy_ratio) continue;
    sum += right[k] * right[k] / pivot;
    for (std::size_t a = k + 1; a < n; ++a) {
      const double factor = matrix[a * n + k] / pivot;
      for (std::size_t b = k + 1; b < n; ++b) matrix[a * n + b] -= factor * matrix[k * n + b];
      right[a] -= factor * right[k];
    }
  }
  return std::clamp(sum, 0.0, 1.0);
}

/// By factor.
struct Shares {
  std::vector<double> share;  // they add up to R^2 of all
  std::vector<double> left;   // what the factors before it leave unexplained, on average
};
Shares shares(const CorrelationMatrix& c) {
  const std::size_t set_count = std::size_t{1} << c.count;
  std::vector<double> r2(set_count);
  for (std::size_t set = 1; set < set_count; ++set) r2[set] = explained(c, set);
  // A set of k others is what comes before a factor in k! (count - k - 1)! of count! orders.
  std::vector<double> weight(c.count);
  for (std::size_t k = 0; k < c.count; ++k)
    weight[k] = std::exp(std::lgamma(static_cast<double>(k) + 1) +
                         std::lgamma(static_cast<double>(c.count - k)) -
                         std::lgamma(static_cast<double>(c.count) + 1));
  Shares result{std::vector<double>(c.count, 0.0), std::vector<double>(c.count, 0.0)};
  for (std::size_t k = 0; k < c.count; ++k) {
    const std::size_t bit = std::size_t{1} << k;
    for (std::size_t set = 0; set < set_count; ++set) {
      if ((set & bit) != 0) continue;
      const double orders = weight[static_cast<std::size_t>(std::popcount(set))];
      result.share[k] += orders * (r2[set | bit] - r2[set]);
      result.left[k] += orders * (1 - r2[set]);
    }
  }
  return result;
}

/// The size of a correlation whose square is the share, on the scale on which those are nearly
/// normal: Fisher's z.
double z_of(double share) { return std::atanh(std::sqrt(std::clamp(share, 0.0, 1 - 1e-9))); }
double share_of(double z) { return std::pow(std::tanh(std::max(z, 0.0)), 2); }

/// 95 % interval of a share, from what it is when each of the cells is left out in turn: "Bias and
/// Confidence in Not-Quite Large Samples", by J. Tukey, Annals of Mathematical Statistics 29(2),
/// 1958.
Interval jackknife_interval(double share, std::span<const double> without_one, double freedom) {
  std::vector<double> z;
  for (double value : without_one) z.push_back(z_of(value));
  const auto count = static_cast<double>(z.size());
  const double standard_error = stddev(z).value_or(0) * (count - 1) / std::sqrt(count);
  const double reach = t_reach(freedom) * standard_error;
  return {share_of(z_of(share) - reach), share_of(z_of(share) + reach)};
}

/// The largest share that chance gives a factor which has nothing to do with the response: what is
/// left for it, times the square of a correlation of independent values.
double chance_share(double left, double freedom) {
  const boost::math::beta_distribution<double> squared(0.5, std::max(freedom, 1.0) / 2);
  return left * boost::math::quantile(squared, 0.975);
}

struct Split {
  double explained = 0;
  std::vector<double> share;
  std::vector<Interval> interval;
};

std::optional<Split> split(const std::vector<Row>& rows) {
  std::vector<std::size_t> all(rows.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  const auto c = correlation_matrix(rows, all);
  if (!c) return std::nullopt;
  const Shares seen = shares(*c);
  std::vector<std::vector<double>> without_one(c->count);
  for (std::size_t out = 0; out < rows.size(); ++out) {
    std::vector<std::size_t> others = all;
    others.erase(others.begin() + static_cast<std::ptrdiff_t>(out));
    const auto c_others = correlation_matrix(rows, others);
    if (!c_others) continue;
    const std::vector<double> share = shares(*c_others).share;
    for (std::size_t k = 0; k < share.size(); ++k) without_one[k].push_back(share[k]);
  }
  Split result;
  result.share = seen.share;
  result.explained = std::accumulate(seen.share.begin(), seen.share.end(), 0.0);
  const auto freedom = static_cast<double>(rows.size()) - static_cast<double>(c->count) - 1;
  for (std::size_t k = 0; k < c->count; ++k) {
    Interval interval = jackknife_interval(seen.share[k], without_one[k], freedom);
    if (seen.share[k] <= chance_share(seen.left[k], freedom)) interval.low = 0;
    result.interval.push_back(interval);
  }
  return result;
}

/// 1 / (1 - R^2) of each factor on the others; nullopt where they make it up.
std::vector<std::optional<double>> inflations(const CorrelationMatrix& c) {
  std::vector<std::optional<double>> result;
  for (std::size_t k = 0; k < c.count; ++k) {
    CorrelationMatrix of_k = c;
    for (std::size_t other = 0; other < c.count; ++other)
      of_k.with[other] = c.between[k * c.count + other];
    const std::size_t others = ((std::size_t{1} << c.count) - 1) & ~(std::size_t{1} << k);
    const double left = 1 - explained(of_k, others);
    result.push_back(left > 1e-6 ? std::optional(1 / left) : std::nullopt);
  }
  return result;
}

/// The value as it enters the model.
std::optional<double> entered(const FactorName& name, const std::optional<double>& value) {
  if (!value || !std::isfinite(*value)) return std::nullopt;
  if (name.as_is) return value;
  return *value > 0 ? std::optional(std::log(*value)) : std::nullopt;
}

std::optional<double> log_of(const std::optional<double>& value) {
  return value && std::isfinite(*value) && *value > 0 ? std::optional(std::log(*value))
                                                      : std::nullopt;
}

}  // namespace

FactorReport explain(std::span<const FactorName> names, std::span<const FactorCell> cells,
                     const FactorConfig& config) {
  FactorReport report;
  for (const FactorName& name : names) report.factors.emplace_back().name = name.name;

  std::vector<const FactorCell*> timed;
  for (const FactorCell& cell : cells)
    if (log_of(cell.time)) timed.push_back(&cell);
  std::vector<std::size_t> used;
  for (std::size_t k = 0; k < names.size(); ++k) {
    std::vector<double> values;
    for (const FactorCell* cell : timed)
      if (const auto value = entered(names[k], cell->value[k])) values.push_back(*value);
    std::string& note = report.factors[k].note;
    const auto spread = stddev(values);
    // Cells that lack a factor cannot be used with it: rather do without a factor than without
    // most.
    if (values.empty())
      note = "unknown in this run";
    else if (2 * values.size() < timed.size())
      note = fmt::format("known for {} of {} cells only", values.size(), timed.size());
    else if (!spread || *spread < 1e-6 * (1 + std::fabs(mean(values))))
      note = "the same in every cell";
    else if (used.size() == max_factor_count)
      note = "too many factors at once";
    else
      used.push_back(k);
  }

  const auto complete = [&](const FactorCell* cell) {
    return std::all_of(used.begin(), used.end(), [&](std::size_t k) {
      return entered(names[k], cell->value[k]).has_value();
    });
  };
  std::vector<Row> time_rows;
  std::vector<Row> energy_rows;
  for (const FactorCell* cell : timed) {
    if (!complete(cell)) continue;
    Row row;
    for (std::size_t k : used) row.push_back(*entered(names[k], cell->value[k]));
    row.push_back(*log_of(cell->time));
    time_rows.push_back(row);
    if (const auto energy = log_of(cell->energy)) {
      row.back() = *energy;
      energy_rows.push_back(row);
    }
  }
  report.cell_count = time_rows.size();
  if (used.empty()) {
    report.notes.emplace_back("No factor is known and differs between cells.");
    return report;
  }
  const std::size_t needed = used.size() + config.spare_cell_count;
  if (time_rows.size() < needed) {
    report.notes.push_back(
        fmt::format("Too few cells: {} for {}; {} are needed. More models or views give more.",
                    counted(time_rows.size(), "cell"), counted(used.size(), "factor"), needed));
    for (std::size_t k : used) report.factors[k].note = "too few cells";
    return report;
  }

  if (const auto time = split(time_rows)) {
    report.explained_time_ratio = time->explained;
    for (std::size_t i = 0; i < used.size(); ++i) {
      report.factors[used[i]].share_of_time_variance = time->share[i];
      report.factors[used[i]].time_interval = time->interval[i];
    }
  } else {
    report.notes.emplace_back("Every cell takes the same time: there is nothing to explain.");
  }
  if (energy_rows.size() >= needed) {
    if (const auto energy = split(energy_rows)) {
      report.explained_energy_ratio = energy->explained;
      for (std::size_t i = 0; i < used.size(); ++i) {
        report.factors[used[i]].share_of_energy_variance = energy->share[i];
        report.factors[used[i]].energy_interval = energy->interval[i];
      }
    }
  } else {
    report.notes.push_back(fmt::format("Energy is known for {}; {} are needed to explain it.",
                                       counted(energy_rows.size(), "cell"), needed));
  }

  std::vector<std::size_t> all(time_rows.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  const auto c = correlation_matrix(time_rows, all);
  if (!c) return report;
  const auto inflation = inflations(*c);
  for (std::size_t i = 0; i < used.size(); ++i) {
    Factor& factor = report.factors[used[i]];
    factor.variance_inflation = inflation[i];
    if (inflation[i] && *inflation[i] <= config.max_variance_inflation) continue;
    std::size_t nearest = i == 0 ? 1 : 0;
    for (std::size_t other = 0; other < used.size(); ++other)
      if (other != i && std::fabs(c->between[i * c->count + other]) >
                            std::fabs(c->between[i * c->count + nearest]))
        nearest = other;
    const double r = c->between[i * c->count + nearest];
    factor.note = fmt::format(
        "cannot be told from {} here (r {:.2f}, variance inflation {}): their shares together mean "
        "something, how they are divided does not",
        std::fabs(r) > 0.9 ? names[used[nearest]].name
                           : fmt::format("the others, first of all {}", names[used[nearest]].name),
        r, inflation[i] ? fmt::format("{:.0f}", *inflation[i]) : "without bound");
    report.notes.push_back(fmt::format("{} {}.", factor.name, factor.note));
  }
  return report;
}

}  // namespace energyprof::analysis
