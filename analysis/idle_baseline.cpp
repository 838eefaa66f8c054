#include "analysis/idle_baseline.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <random>

#include "analysis/nnls.h"

namespace energyprof::analysis {
namespace {

/// With fewer stretches their pieces are the units.
constexpr std::size_t min_stretch_count = 4;

IdleBaseline::Shape powers(double u) { return {1, u, u * u, u * u * u}; }

}  // namespace

IdleBaseline::IdleBaseline(const std::vector<IdlePiece>& pieces) {
  if (pieces.empty()) return;
  std::map<std::size_t, std::vector<const IdlePiece*>> stretches;
  int64_t begin_ns = pieces.front().begin_ns;
  int64_t end_ns = pieces.front().end_ns;
  for (const IdlePiece& piece : pieces) {
    stretches[piece.stretch].push_back(&piece);
    begin_ns = std::min(begin_ns, piece.begin_ns);
    end_ns = std::max(end_ns, piece.end_ns);
  }
  middle_ns_ = (static_cast<double>(begin_ns) + static_cast<double>(end_ns)) / 2;
  half_ns_ = std::max(static_cast<double>(end_ns - begin_ns) / 2, 1.0);

  std::vector<std::vector<const IdlePiece*>> groups;
  for (const auto& [stretch, members] : stretches) {
    if (stretches.size() >= min_stretch_count) {
      groups.push_back(members);
    } else {
      for (const IdlePiece* piece : members) groups.push_back({piece});
    }
  }
  double joules_sum = 0;
  double length_sum_s = 0;
  for (const auto& group : groups) {
    Unit unit;
    double joules = 0;
    double squares = 0;
    double moment = 0;
    for (const IdlePiece* piece : group) {
      const double length_s = static_cast<double>(piece->end_ns - piece->begin_ns) * 1e-9;
      const double middle_ns =
          (static_cast<double>(piece->begin_ns) + static_cast<double>(piece->end_ns)) / 2;
      joules += piece->joules;
      squares += piece->error_j * piece->error_j;
      unit.length_s += length_s;
      moment += length_s * scaled_time(middle_ns);
    }
    unit.u = moment / unit.length_s;
    unit.watts = joules / unit.length_s;
    unit.error_w = std::sqrt(squares) / unit.length_s;
    units_.push_back(unit);
    joules_sum += joules;
    length_sum_s += unit.length_s;
  }
  mean_w_ = joules_sum / length_sum_s;

  std::vector<double> watts;
  for (const Unit& unit : units_) watts.push_back(unit.watts);
  const auto n = static_cast<double>(units_.size());
  const std::size_t highest = std::min(max_term_count - 1, stretches.size() / 2);
  std::size_t best = 0;
  double least = 0;
  for (std::size_t degree = 0; degree <= highest; ++degree) {
    const double spare = n - static_cast<double>(degree) - 3;  // beyond the terms and the spread
    if (degree > 0 && (spare < 1 || !set_degree(degree))) break;
    if (degree == 0) set_degree(0);
    const Terms terms = fit(watts);
    double squares = 0;
    for (const Unit& unit : units_) {
      const double left = unit.watts - joules(powers(unit.u), terms);
      squares += unit.length_s * left * left;
    }
    // What edges alone make is no reason for a higher degree, and nothing is less than rounding.
    const double floor = 1e-12 * mean_w_ * mean_w_ * length_sum_s;
    const double parameters = static_cast<double>(degree) + 2;
    const double criterion = n * std::log(std::max(squares, floor) + 1e-300) + 2 * parameters +
                             2 * parameters * (parameters + 1) / std::max(spare, 1.0);
    if (degree > 0 && criterion >= least) continue;
    least = criterion;
    best = degree;
  }
  set_degree(best);
  terms_ = fit(watts);
}

double IdleBaseline::scaled_time(double t_ns) const {
  return std::clamp((t_ns - middle_ns_) / half_ns_, -1.0, 1.0);
}

bool IdleBaseline::set_degree(std::size_t degree) {
  const std::size_t width = degree + 1;
  std::vector<double> ata(width * width, 0.0);
  for (const Unit& unit : units_) {
    const Shape power = powers(unit.u);
    for (std::size_t a = 0; a < width; ++a)
      for (std::size_t b = 0; b < width; ++b)
        ata[a * width + b] += unit.length_s * power[a] * power[b];
  }
  std::vector<Terms> weight;
  for (const Unit& unit : units_) {
    const Shape power = powers(unit.u);
    std::vector<double> right;
    for (std::size_t a = 0; a < width; ++a) right.push_back(unit.length_s * power[a]);
    const auto column = solve_symmetric(ata, right);
    if (!column) return false;
    Terms& terms = weight.emplace_back();
    terms.fill(0);
    std::copy(column->begin(), column->end(), terms.begin());
  }
  term_count_ = width;
  weight_ = std::move(weight);
  return true;
}

IdleBaseline::Terms IdleBaseline::fit(const std::vector<double>& watts) const {
  Terms terms{};
  for (std::size_t i = 0; i < watts.size(); ++i)
    for (std::size_t k = 0; k < term_count_; ++k) terms[k] += weight_[i][k] * watts[i];
  return terms;
}

IdleBaseline::Shape IdleBaseline::shape(int64_t begin_ns, int64_t end_ns) const {
  Shape shape =
      powers(scaled_time((static_cast<double>(begin_ns) + static_cast<double>(end_ns)) / 2));
  for (double& seconds : shape) seconds *= static_cast<double>(end_ns - begin_ns) * 1e-9;
  return shape;
}

double IdleBaseline::joules(const Shape& shape, const Terms& terms) {
  double sum = 0;
  for (std::size_t k = 0; k < max_term_count; ++k) sum += shape[k] * terms[k];
  return sum;
}

double IdleBaseline::freedom() const {
  return std::max(static_cast<double>(units_.size()) - static_cast<double>(term_count_), 1.0);
}

std::vector<IdleBaseline::Terms> IdleBaseline::draw(std::size_t count, uint64_t seed) const {
  std::vector<Terms> result;
  if (units_.empty()) return result;
  // Residuals of the same spread: short units scatter more.
  std::vector<double> fitted;
  std::vector<double> residual;
  const double stretch_out = std::sqrt(static_cast<double>(units_.size()) / freedom());
  for (const Unit& unit : units_) {
    fitted.push_back(joules(powers(unit.u), terms_));
    residual.push_back((unit.watts - fitted.back()) * std::sqrt(unit.length_s) * stretch_out);
  }
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::vector<double> watts(units_.size());
  for (std::size_t replicate = 0; replicate < count; ++replicate) {
    for (std::size_t i = 0; i < units_.size(); ++i)
      watts[i] = fitted[i] + residual[random() % residual.size()] / std::sqrt(units_[i].length_s) +
                 normal(random) * units_[i].error_w;
    result.push_back(fit(watts));
  }
  return result;
}

}  // namespace energyprof::analysis
