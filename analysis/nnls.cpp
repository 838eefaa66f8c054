#include "analysis/nnls.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace energyprof::analysis {
namespace {

/// The unconstrained solution on the columns of `used`; the others are 0.
std::optional<std::vector<double>> solve_on(std::span<const double> ata,
                                            std::span<const double> atb,
                                            const std::vector<bool>& used) {
  const std::size_t n = atb.size();
  std::vector<std::size_t> columns;
  for (std::size_t i = 0; i < n; ++i)
    if (used[i]) columns.push_back(i);
  std::vector<double> matrix;
  std::vector<double> right;
  for (std::size_t row : columns) {
    for (std::size_t column : columns) matrix.push_back(ata[row * n + column]);
    right.push_back(atb[row]);
  }
  const auto part = solve_symmetric(std::move(matrix), std::move(right));
  if (!part) return std::nullopt;
  std::vector<double> x(n, 0.0);
  for (std::size_t k = 0; k < columns.size(); ++k) x[columns[k]] = (*part)[k];
  return x;
}

}  // namespace

std::optional<std::vector<double>> solve_symmetric(std::vector<double> matrix,
                                                   std::vector<double> right) {
  const std::size_t n = right.size();
  assert(matrix.size() == n * n);
  // Scaled to ones on the diagonal, so that units do not decide what counts as rounding.
  std::vector<double> scale(n);
  for (std::size_t i = 0; i < n; ++i) {
    if (!(matrix[i * n + i] > 0)) return std::nullopt;
    scale[i] = 1 / std::sqrt(matrix[i * n + i]);
  }
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < n; ++j) matrix[i * n + j] *= scale[i] * scale[j];
    right[i] *= scale[i];
  }
  // Cholesky: matrix = L L'.
  for (std::size_t j = 0; j < n; ++j) {
    for (std::size_t i = j; i < n; ++i) {
      double sum = matrix[i * n + j];
      for (std::size_t k = 0; k < j; ++k) sum -= matrix[i * n + k] * matrix[j * n + k];
      if (i == j) {
        if (sum < 1e-10) return std::nullopt;
        matrix[j * n + j] = std::sqrt(sum);
      } else {
        matrix[i * n + j] = sum / matrix[j * n + j];
      }
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t k = 0; k < i; ++k) right[i] -= matrix[i * n + k] * right[k];
    right[i] /= matrix[i * n + i];
  }
  for (std::size_t i = n; i-- > 0;) {
    for (std::size_t k = i + 1; k < n; ++k) right[i] -= matrix[k * n + i] * right[k];
    right[i] /= matrix[i * n + i];
  }
  for (std::size_t i = 0; i < n; ++i) right[i] *= scale[i];
  return right;
}

std::optional<std::vector<double>> non_negative_least_squares(std::span<const double> ata,
                                                              std::span<const double> atb) {
  const std::size_t n = atb.size();
  assert(ata.size() == n * n);
  std::vector<double> x(n, 0.0);
  std::vector<bool> used(n);
  for (std::size_t i = 0; i < n; ++i) used[i] = ata[i * n + i] > 0;
  // Mostly nothing would become negative, and this is the answer.
  const auto all = solve_on(ata, atb, used);
  if (!all) return std::nullopt;
  if (std::all_of(all->begin(), all->end(), [](double v) { return v >= 0; })) return all;
  used.assign(n, false);
  for (std::size_t step = 0; step < 3 * n + 1; ++step) {
    // The column that would lower the error fastest, if any would.
    std::optional<std::size_t> enter;
    double steepest = 0;
    for (std::size_t i = 0; i < n; ++i) {
      if (used[i] || !(ata[i * n + i] > 0)) continue;
      double slope = atb[i];
      for (std::size_t j = 0; j < n; ++j) slope -= ata[i * n + j] * x[j];
      slope /= std::sqrt(ata[i * n + i]);
      if (slope > steepest + 1e-12 * std::fabs(atb[i]) / std::sqrt(ata[i * n + i])) {
        steepest = slope;
        enter = i;
      }
    }
    if (!enter) return x;
    used[*enter] = true;
    for (;;) {
      const auto solution = solve_on(ata, atb, used);
      if (!solution) return std::nullopt;
      // As far as possible towards it without anything becoming negative.
      double reach = 1;
      std::optional<std::size_t> leave;
      for (std::size_t i = 0; i < n; ++i) {
        if (!used[i] || (*solution)[i] > 0) continue;
        const double share = x[i] > 0 ? x[i] / (x[i] - (*solution)[i]) : 0;
        if (leave && share >= reach) continue;
        reach = share;
        leave = i;
      }
      if (!leave) {
        x = *solution;
        break;
      }
      for (std::size_t i = 0; i < n; ++i)
        if (used[i]) x[i] += reach * ((*solution)[i] - x[i]);
      x[*leave] = 0;
      used[*leave] = false;
    }
  }
  return x;
}

}  // namespace energyprof::analysis
