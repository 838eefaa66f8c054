/// Least squares with coefficients that cannot be negative.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

namespace energyprof::analysis {

/// Solves the symmetric positive definite system matrix x = right (`matrix` row by row). nullopt
/// where it has no unique solution, within rounding.
std::optional<std::vector<double>> solve_symmetric(std::vector<double> matrix,
                                                   std::vector<double> right);

/// The x >= 0 that minimizes |A x - b|, given A'A (row by row) and A'b. nullopt where columns
/// cannot be told apart. Columns of zeros get 0.
///
/// See "Solving Least Squares Problems", by C. Lawson and R. Hanson, Prentice-Hall 1974, chapter
/// 23; on A'A as in "A Fast Non-Negativity-Constrained Least Squares Algorithm", by R. Bro and S.
/// de Jong, Journal of Chemometrics 11(5), 1997.
std::optional<std::vector<double>> non_negative_least_squares(std::span<const double> ata,
                                                              std::span<const double> atb);

}  // namespace energyprof::analysis
